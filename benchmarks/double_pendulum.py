"""The measured double pendulum: its estimates beside those of its owners, also on other records.

    python benchmarks/double_pendulum.py URDF

writes benchmarks/results/robots/double-pendulum.csv. Every method sees the closed-loop record
alone; the two open-loop records are held out. It hardly accelerates, so four more rows are least
squares on it and one open-loop record, and the other one is held out: every sample counts the same,
or each joint of each record by what is left of it. The model has friction that
grows with the torque, as a gear's does. Figures are the rms of the torque that the parameters
leave, N m, behind a low-pass of 10 Hz on the position, for its second differences are mostly noise
beyond.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd

import ivtools as iv
from ivtools.loop import Controller

RESULTS = Path(__file__).parent / "results" / "robots" / "double-pendulum.csv"
TERMS = ("inertia", "viscous", "coulomb", "offset", "load-friction")
CUTOFF_HZ = 10.0
MOTOR = 6.1e-5 * 6.0**2  # kg m2, behind the gear
LENGTH = 0.3  # m, of the first link
#: What the owners state: masses, centres of mass, inertias about the joints, frictions.
OWNERS = {
    "owners 1": ((0.608, 0.630), (0.275, 0.166), (0.0547, 0.0252), (0.081, 0.0), (0.093, 0.186)),
    "owners 2": ((0.559, 0.604), (0.300, 0.184), (0.0535, 0.0239), (0.001, 0.001), (0.093, 0.078)),
}


def loop(urdf: str, terms: tuple[str, ...] = TERMS) -> iv.RobotLoop:
    """The robot under its PD laws, on the velocities that the drives logged."""
    axes = [
        iv.ClosedLoop(
            Controller("pd", {"kp": kp, "kd": kd}, velocity="logged"), 1.0, terms, joint="revolute"
        )
        for kp, kd in ((20.06, 0.52), (19.94, 0.46))
    ]
    return iv.RobotLoop(iv.Robot.from_urdf(urdf), axes)


def owners(m, r, inertia, viscous, coulomb, names) -> dict[str, float]:
    """The base parameters of what the owners state, in the frames of the model."""
    stated = {
        "ZZ1R": inertia[0] + LENGTH**2 * m[1] + MOTOR,
        "MX1R": m[0] * r[0] + LENGTH * m[1],
        "ZZ2": inertia[1],
        "MX2": -m[1] * r[1],
        "Joint2.inertia": MOTOR,
    }
    for joint, fv, fc in zip(("Joint1", "Joint2"), viscous, coulomb, strict=True):
        stated |= {f"{joint}.viscous": fv, f"{joint}.coulomb": fc}
    return dict.fromkeys(names, 0.0) | stated


def errors(problem: iv.Problem, theta: dict[str, float]) -> list[float]:
    """The rms of the torque that the parameters leave, per joint, N m."""
    left = problem.y - problem.X @ [theta[name] for name in problem.names]
    return [float(np.sqrt(np.mean(left[problem.row_joints == j] ** 2))) for j in (0, 1)]


def together(problems: list[iv.Problem], rounds: int) -> dict[str, float]:
    """Least squares over several records.

    From the second round on each joint of each record is weighed by what is left of it.
    """
    weights = [np.ones(len(p.y)) for p in problems]
    for _ in range(rounds):
        roots = [np.sqrt(w) for w in weights]
        X = np.vstack([p.X * w[:, np.newaxis] for p, w in zip(problems, roots, strict=True)])
        y = np.concatenate([p.y * w for p, w in zip(problems, roots, strict=True)])
        theta = dict(zip(problems[0].names, np.linalg.lstsq(X, y)[0].tolist(), strict=True))
        for p, w in zip(problems, weights, strict=True):
            w[:] = (1.0 / np.square(errors(p, theta)))[p.row_joints]
    return theta


def main(urdf: str) -> None:
    robot = loop(urdf)
    names = ("dfki-double-pendulum", "dfki-double-pendulum-open-1", "dfki-double-pendulum-open-2")
    records = [iv.datasets.load(name) for name in names]
    problems = [
        iv.Problem(record, robot, robot.pipeline(record, cutoff_hz=CUTOFF_HZ)) for record in records
    ]
    found, rows = {}, []
    for method in (iv.IDIMLS(), iv.IDIMWLS(), iv.IDIMIV(), iv.DIDIM()):
        fit = method.fit(problems[0])
        assert fit.converged, method.key
        found[method.key] = {str(name): float(value) for name, value in fit.params.items()}
    phi = robot.consistent(found["idim-iv"], problems[0].X)
    consistent = dict(zip(robot.names, (robot.base.matrix @ phi).tolist(), strict=True))
    found["idim-iv, links that can exist"] = consistent
    for kind, rounds in (("least squares", 1), ("weighted least squares", 8)):
        for k in (1, 2):
            both = [problems[0], problems[k]]
            found[f"{kind}, closed loop and open {k}"] = together(both, rounds)
    for name, stated in OWNERS.items():
        found[name] = owners(*stated, robot.names)
    for name, theta in found.items():
        figures = [x for problem in problems for x in errors(problem, theta)]
        rows.append([name, *figures])
    columns = [
        f"{r} {j}" for r in ("closed loop", "open 1", "open 2") for j in ("shoulder", "elbow")
    ]
    table = pd.DataFrame(rows, columns=["parameters", *columns])
    RESULTS.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(RESULTS, index=False, float_format="%.4g")
    print(table.to_string(index=False, float_format="{:.3f}".format))


if __name__ == "__main__":
    main(sys.argv[1])
