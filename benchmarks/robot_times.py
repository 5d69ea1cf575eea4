"""Exciting motions of the six-joint arm over several seeds, and its closed loop beside MuJoCo's.

    python benchmarks/robot_times.py [--seeds 5] [--rounds 5]

writes benchmarks/results/robots/excitation.csv: per seed the condition number of the motion that is
found, that of the best of sixty random ones within the same limits, and the processor time; and
prints the time of 30 s at 1 kHz of the arm under its PD laws, here with exact dry friction, and in
MuJoCo (if it is there) with its own soft one. `idle` is the time of a loop of 10^7 additions, which
takes 0.6 to 0.7 s on the machine when nothing else runs.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from time import process_time

import numpy as np
import pandas as pd

import ivtools as iv
from ivtools.excitation import Limits, fourier

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from robots import SIX_GAINS, plan, reference, six_loop

RESULTS = Path(__file__).parent / "results" / "robots" / "excitation.csv"
URDF = Path(iv.robot.__file__).parent / "six_axis.urdf"
SECONDS = 30.0


def idle() -> float:
    """Return the time of a loop of 10^7 additions, s."""
    start, total = process_time(), 0
    for i in range(10**7):
        total += i
    return process_time() - start


def excited(seed: int) -> dict[str, float]:
    """Return the condition numbers of one seed, and the processor time."""
    loop, start = six_loop(), process_time()
    found = fourier(loop, Limits.of({}, loop.joints, robot=loop.robot), seconds=20.0, seed=seed)
    used = process_time() - start
    best = found.settings["best_random"]
    return {
        "seed": seed,
        "condition": found.condition,
        "random": best,
        "seconds": used,
        "idle": idle(),
    }


def simulated(rounds: int) -> float:
    """Return the time of a simulation here, s: the least of several."""
    loop = six_loop()
    t, q_ref = reference(SECONDS)
    record = plan(t, q_ref)
    return least(lambda: loop.simulate(record, initial="rest"), rounds)


def rolled_out(rounds: int) -> float:
    """Return the time of MuJoCo's rollout of the same arm, s."""
    import mujoco as mj
    from mujoco import rollout

    loop, spec = six_loop(), mj.MjSpec.from_file(str(URDF))
    spec.option.timestep, spec.option.integrator = 1e-3, mj.mjtIntegrator.mjINT_EULER
    spec.option.disableflags |= int(mj.mjtDisableBit.mjDSBL_CONTACT)
    spec.option.disableflags |= int(mj.mjtDisableBit.mjDSBL_LIMIT)
    for name, axis, kp, kd in zip(loop.joints, loop.axes, *SIX_GAINS, strict=True):
        joint = spec.joint(name)
        joint.armature, joint.frictionloss = axis.start["inertia"], axis.start["coulomb"]
        damping = np.asarray(joint.damping, dtype=float).ravel()
        joint.damping = (
            axis.start["viscous"] if damping.size == 1 else [axis.start["viscous"], 0, 0]
        )
        drive = spec.add_actuator(name=name, target=name, trntype=mj.mjtTrn.mjTRN_JOINT)
        drive.gainprm[0], drive.biastype = 1.0, mj.mjtBias.mjBIAS_AFFINE
        drive.biasprm[:3] = 0.0, -kp, -kd
    model = spec.compile()
    data = mj.MjData(model)
    t, q_ref = reference(SECONDS)
    kp, kd = (np.array(x) for x in SIX_GAINS)
    control = kp * q_ref + kd * np.gradient(q_ref, 1e-3, axis=0)
    size = mj.mj_stateSize(model, mj.mjtState.mjSTATE_FULLPHYSICS)
    state = np.zeros(size)
    mj.mj_getState(model, data, state, mj.mjtState.mjSTATE_FULLPHYSICS)
    return least(lambda: rollout.rollout(model, data, state, control), rounds)


def least(run: Callable[[], object], rounds: int) -> float:
    """Return the least processor time of several runs behind a first one, s."""
    run()
    times = []
    for _ in range(rounds):
        start = process_time()
        run()
        times.append(process_time() - start)
    return min(times)


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    print(f"idle {idle():.2f} s")
    print(f"simulated {1e3 * simulated(given.rounds):.0f} ms")
    try:
        print(f"MuJoCo {1e3 * rolled_out(given.rounds):.0f} ms")
    except ImportError:
        print("MuJoCo is not installed")
    rows = []
    for seed in range(given.seeds):
        rows.append(excited(seed))
        print(rows[-1], flush=True)
        pd.DataFrame(rows).to_csv(RESULTS, index=False, float_format="%.4g")


if __name__ == "__main__":
    main()
