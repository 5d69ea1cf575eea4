"""The registered data sets: what each is, where it comes from, and its checksum."""

from __future__ import annotations

from dataclasses import dataclass

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
        Address of the zip archive that holds the file.
    licence, citation : str
        Terms of use and what to cite.
    axis : str
        The registered axis it was recorded on.
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
    )
}
