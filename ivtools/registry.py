"""The registered data sets: what each is, where it comes from, and its checksums."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = ["REGISTRY", "DataSet"]

SITE = "https://www.nonlinearbenchmark.org/benchmarks/emps"
EMPS_ARCHIVE = "https://drive.google.com/uc?export=download&id=1zwoXYa9-3f8NQ0ohzmjpF7UxbNgRTHkS"
EMPS_CITATION = (
    "A. Janot, M. Gautier, M. Brunot, Data Set and Reference Models of EMPS, "
    "2019 Workshop on Nonlinear System Identification Benchmarks, Eindhoven, 2019"
)
EMPS_LICENCE = "published for benchmarking; not re-distributed with ivtools"


@dataclass(frozen=True)
class DataSet:
    """What is known about a registered data set.

    Attributes
    ----------
    name : str
        Name in the registry and on the command line.
    title : str
        What it is.
    filename, sha256 : str
        The file and its checksum; empty for a simulated data set, which has none.
    origin : str
        Where a person finds it.
    archive : str
        Address of the zip archive that holds the file, under whatever name.
    licence, citation : str
        Terms of use and what to cite.
    axis : str
        The registered axis it was recorded on; empty for several joints.
    folder : str
        Name of the folder that may hold the owner's files.
    beside : mapping of str to str
        Further files that are read with it, and their checksums.
    reader, part : str
        How its files become a record (`ivtools.measured`), and which part of them; without a
        reader it is a record file.
    """

    name: str
    title: str
    filename: str
    sha256: str
    origin: str
    archive: str
    licence: str
    citation: str
    axis: str
    folder: str = ""
    beside: Mapping[str, str] = field(default_factory=dict)
    reader: str = ""
    part: str = ""

    @property
    def files(self) -> dict[str, str]:
        """Every file and its checksum; none if it is simulated."""
        return {self.filename: self.sha256, **self.beside} if self.filename else {}


def _github(repository: str, folder: str, licence: str, citation: str) -> dict[str, Any]:
    """Return what the data sets of one repository have in common."""
    origin = f"https://github.com/{repository}"
    return {
        "origin": origin,
        "archive": f"{origin}/archive/HEAD.zip",
        "licence": licence,
        "citation": citation,
        "folder": folder,
        "reader": folder,
    }


_LAAS = _github(
    "heitor-andrade/laas_anti_cogging",
    "laas-motor",
    "BSD-3-Clause",
    "H. Andrade, Anti-cogging of a brushless motor, LAAS-CNRS, Toulouse, 2023",
)
_QUANSER = _github(
    "basta/quanser-2-dof-serial-flexible-link",
    "quanser-flexible-link",
    "MIT",
    "aa4cc / Edu Ctrl Lab Models, Quanser 2 DOF serial flexible link, "
    "Czech Technical University in Prague, 2022",
)
_PENDULUM = _github(
    "dfki-ric-underactuated-lab/torque_limited_simple_pendulum",
    "dfki-pendulum",
    "BSD-3-Clause",
    "F. Wiebe, J. Babel, S. Kumar, S. Vyas, D. Harnack, M. Boukheddimi, M. Popescu, F. Kirchner, "
    "Torque-limited simple pendulum, J. Open Source Software 7(74), 3884, 2022",
)
_DOUBLE = _github(
    "dfki-ric-underactuated-lab/double_pendulum",
    "dfki-double-pendulum",
    "BSD-3-Clause",
    "F. Wiebe, S. Kumar, L. J. Shala, S. Vyas, M. Javadi, F. Kirchner, Open source dual-purpose "
    "acrobot and pendubot platform, IEEE Robotics and Automation Magazine 31(2), 2024",
)
_SPEED_TESTS = {
    "speed_test1.txt": "b098ab15e4f503952e62aad85d57ffd4cc58b4f7e0610aba09c7b61e54d5ea3f",
    "speed_test.txt": "0e92a000db264e76a871fa92989fc657c819dd42219823daab1bbc453e300d73",
    "speed_test_old.txt": "14f676888c0a22de26c50adcc6dec1e11d3ceedcfbadf522024b5060d33d7684",
}
#: Measured and desired files of the pendulum, by experiment.
_SWINGS = {
    "ddp": (
        "14748fd189abae7b6392a016f2f0494b54bb2a8c014bc435a84b58dbecb2da35",
        "6699a4d2c29811e86b31d8868f8f6a470e6fc51eecb0daa2d2c5c4dcc2a91c0b",
    ),
    "direct-collocation": (
        "c3f990980169815b93ab37078780e13803327dcb6fc9e019f2d261b988cdaf8f",
        "f80b8835e611bbd62971b345b87a4c46306b18825677d6443bba8e5a09e8bf6a",
    ),
    "pd": (
        "3a5728e9c5530dd9066c0d7fda4c6a9bf50d86f94538629ace6d2508a7053469",
        "dafa758caad5b48c32bb0dd6b9547a66599980568cc6d1a80af5c8838a263985",
    ),
    "energy-shaping": (
        "e1844e56f87cf763bdecb3f6f7e5b622a9a3b2d71e907b48ed6148b0a059c209",
        "503dceac0c5098aaff4ee8375422a44ad4aebdb47d308aa8578c34dac09f9762",
    ),
}
_CLOSED = ("closed-loop-pos-20.csv", "reference-pos-20.csv")
_CLOSED_SHA256 = (
    "af4f48db0bb984e527c7155cef9e303343cc958d8c8fc528e465823c51b615e8",
    "eab7435bb58db85031cf5860a58a35e964de32256cef617f4ce9ea50c60747b1",
)
_OPEN = {
    "open-loop-055032.csv": "30986e4eda0f559c30b0c009009e8943f3cac32cf5dcbcdc1c088ae638942b3a",
    "open-loop-055640.csv": "59a9499806aedc30cc16e6b7b310c0c9c95f58fe4f003c1bcfe5e3192f441095",
}


def _other_machines() -> list[DataSet]:
    """Return the data sets of machines other than the EMPS."""
    sets = []
    for number, (file, sha256) in enumerate(_SPEED_TESTS.items(), start=1):
        for part, state in (("", "off"), ("compensated", "on")):
            name = f"laas-motor-{number}" + (f"-{part}" if part else "")
            title = f"brushless motor under velocity control, compensation of cogging {state}"
            sets.append(DataSet(name, title, file, sha256, axis="laas-motor", part=part, **_LAAS))
    sets.append(
        DataSet(
            "quanser-flexible-link",
            "geared motor with a flexible link under state feedback: joint 1",
            "lqr_full_10deg.mat",
            "07d75adb0c3e938f9a91653df214acc9e34575f8c1992e8b08249761f6d2ec26",
            axis="quanser-flexible-link",
            **_QUANSER,
        )
    )
    for name, (measured, desired) in _SWINGS.items():
        file = name.replace("-", "_")
        sets.append(
            DataSet(
                f"dfki-pendulum-{name}",
                f"pendulum on a geared drive: swing-up by {name.replace('-', ' ')}",
                f"{file}_measured.csv",
                measured,
                axis="dfki-pendulum",
                beside={f"{file}_desired.csv": desired},
                **_PENDULUM,
            )
        )
    for part, axis in (("", ""), ("1", "dfki-shoulder"), ("2", "dfki-elbow")):
        sets.append(
            DataSet(
                axis or "dfki-double-pendulum",
                f"double pendulum in closed loop: {axis.removeprefix('dfki-') or 'both joints'}",
                _CLOSED[0],
                _CLOSED_SHA256[0],
                axis=axis,
                beside={_CLOSED[1]: _CLOSED_SHA256[1]},
                part=part,
                **_DOUBLE,
            )
        )
    for number, (file, sha256) in enumerate(_OPEN.items(), start=1):
        name = f"dfki-double-pendulum-open-{number}"
        title = "double pendulum under sinusoidal torques, no controller: both joints"
        sets.append(DataSet(name, title, file, sha256, axis="", **_DOUBLE))
    return sets


#: The registered data sets by name.
REGISTRY: dict[str, DataSet] = {
    data_set.name: data_set
    for data_set in (
        DataSet(
            name="emps",
            title="EMPS, measured: estimation record",
            filename="DATA_EMPS.mat",
            sha256="6cf6814ae14618795da0101aae2bb97ff0c6351b0501b5492751b02b07facf7e",
            origin=SITE,
            archive=EMPS_ARCHIVE,
            licence=EMPS_LICENCE,
            citation=EMPS_CITATION,
            axis="emps",
            folder="emps",
        ),
        DataSet(
            name="emps-pulses",
            title="EMPS, measured: validation record with pulses added to the command",
            filename="DATA_EMPS_PULSES.mat",
            sha256="0eab75bb1f6b16228ee78791343a88bf9bfd9a51036ac9807d7b5fc11c0e1704",
            origin=SITE,
            archive=EMPS_ARCHIVE,
            licence=EMPS_LICENCE,
            citation=EMPS_CITATION,
            axis="emps",
            folder="emps",
        ),
        DataSet(
            name="twin",
            title="EMPS-like axis, simulated: known parameters, asymmetric friction, noise",
            filename="",
            sha256="",
            origin="simulated by ivtools",
            archive="",
            licence="BSD-3-Clause",
            citation="ivtools",
            axis="emps",
        ),
        *_other_machines(),
    )
}
