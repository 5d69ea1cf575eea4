"""Run the timings and write benchmarks/results/speed.md and speed.json.

    python benchmarks/speed/report.py

Run it on a machine that does nothing else. The table says what the machine was.
"""

import json
import os
import platform
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

HERE = Path(__file__).parent
RESULTS = HERE.parent / "results"
COMMAND = "python benchmarks/speed/report.py"
LABELS = {
    "test_simulation_rigid": "simulation of 24841 samples, symmetric friction",
    "test_simulation_asymmetric": "the same, asymmetric friction",
    "test_simulation_with_an_effect[position-friction]": "the same, friction over position",
    "test_simulation_with_an_effect[stribeck]": "the same with the Stribeck effect",
    "test_simulation_with_an_effect[flexibility]": "the same with two masses",
    "test_least_squares_fit": "IDIM-LS, from the record to the estimate",
    "test_simulation_of_six_joints": "simulation of six joints, 30 s at 1 kHz",
    "test_regressor_of_six_joints": "regressor of six joints, 30 000 rows",
    "test_import": "import ivtools, new process",
    "test_identify_from_a_cold_shell": "ivtools identify twin --method idim-ls, new process",
}


def timings() -> list[dict]:
    """Run pytest-benchmark; a limit that is missed does not stop the others."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "speed.json"
        command = [
            sys.executable,
            "-m",
            "pytest",
            str(HERE),
            "-q",
            "--benchmark-max-time=0.3",
            f"--benchmark-json={out}",
        ]
        subprocess.run(command, check=False, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"})
        return json.loads(out.read_text())["benchmarks"]


def machine() -> dict[str, str]:
    cpu, info = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.split(":")[1] for line in info.read_text().splitlines() if "model name" in line
        ]
        cpu = names[0].strip() if names else cpu
    libraries = ("numpy", "scipy", "numba", "llvmlite", "control", "pandas", "statsmodels")
    return {
        "processor": f"{cpu}, {os.cpu_count()} cores",
        "load before the run": f"{os.getloadavg()[0]:.1f} processes",
        "system": f"{platform.system()} {platform.release()}, Python {platform.python_version()}",
        "libraries": ", ".join(f"{name} {version(name)}" for name in libraries),
    }


def table(rows: list[dict]) -> str:
    named = {row["name"]: row for row in rows}
    lines = [
        "| what | processor, ms | least, ms | median, ms | limit, ms | kept |",
        "|---|---:|---:|---:|---:|:---:|",
    ]
    for name, label in LABELS.items():
        if name not in named:
            continue
        stats, info = named[name]["stats"], named[name]["extra_info"]
        kept = "yes" if info["processor_ms"] <= info["limit_ms"] else "no"
        cells = [info["processor_ms"], 1e3 * stats["min"], 1e3 * stats["median"], info["limit_ms"]]
        lines.append(f"| {label} | {' | '.join(f'{cell:.4g}' for cell in cells)} | {kept} |")
    ratio = named.get("test_ratio_to_python_control", {}).get("extra_info", {}).get("ratio")
    if ratio:
        lines += ["", f"Against python-control's own run in the same process: {ratio:.0f} times "
                  "faster per sample (at least 800 asked for)."]  # fmt: skip
    return "\n".join(lines)


def scaling(rows: list[dict]) -> str:
    found = [row["extra_info"] for row in rows if "rows_bytes" in row["extra_info"]]
    lines = [
        "| samples | simulation, ns/sample | bytes/sample/signal | IDIM-LS, ns/sample "
        "| bytes/sample/signal |",
        "|---:|---:|---:|---:|---:|",
    ]
    for f in sorted(found, key=lambda f: f["samples"]):
        lines.append(
            f"| {f['samples']:.0e} | {f['simulate_ns']:.0f} | {f['simulate_bytes']:.1f} "
            f"| {f['rows_ns']:.0f} | {f['rows_bytes']:.1f} |"
        )
    return "\n".join(lines)


def main() -> None:
    about, rows = machine(), timings()
    text = "\n".join(
        [
            "# Speed",
            "",
            f"Written by `{COMMAND}`. Processor time of one thread, the best of many, is what the "
            "limits are for; the elapsed times beside it show how busy the machine was.",
            "",
            *(f"- {key}: {value}" for key, value in about.items()),
            "",
            table(rows),
            "",
            "## Cost over the length of the record",
            "",
            "Peak memory above the input, at most 40 bytes per sample and signal; the six signals "
            "are time, position, reference, command, velocity, acceleration. Elapsed time.",
            "",
            scaling(rows),
            "",
        ]
    )
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "speed.md").write_text(text)
    kept = [
        {
            "name": row["name"],
            **row["extra_info"],
            "min_s": row["stats"]["min"],
            "median_s": row["stats"]["median"],
        }
        for row in rows
    ]
    document = {"command": COMMAND, "machine": about, "timings": kept}
    (RESULTS / "speed.json").write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
