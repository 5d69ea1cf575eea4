"""Other tools on the same file: FIGAROH and MuJoCo's sysid beside this library, six joints.

    python benchmarks/robot_peers.py [--seeds 3] [--tools ivtools figaroh mujoco]

writes rows to benchmarks/results/robots/peers.csv. Every tool reads the same csv: 20 s at 1 kHz of
the generic arm under its PD laws, encoder noise 2e-4 rad, torque noise 1 %. Needs an environment of
its own with `figaroh` and `mujoco[sysid]`. What each tool does:

- ivtools: `idim-wls` and `idim-iv`, nothing chosen by hand.
- FIGAROH: its regressor, base parameters and weighted least squares; the filter is left to its
  user, who takes 4 Hz here, 5 times the band of the motion (10 and 2.5 Hz did worse), at 100 Hz.
- MuJoCo: rollouts under the same control laws, residuals of positions and torques, its optimiser
  with its defaults, eight iterations; masses begin a fifth too heavy, frictions a half too small.

Errors: torque along the hold-out's own motion without noise, rms of the worst joint, % of that
joint's torque; the diagonal of the mass matrix along it, % at the joint with the largest mean.
"""

import argparse
import tempfile
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from time import process_time, time

import numpy as np
import pandas as pd

import ivtools as iv
from ivtools import robot as robots
from ivtools.pipeline import Motion

HERE = Path(__file__).parent
RESULTS = HERE / "results" / "robots" / "peers.csv"
URDF = Path(robots.__file__).parent / "six_axis.urdf"
NOISE, HZ, EVERY = 2e-4, 4.0, 10
START = {"mass": 1.2, "friction": 0.5}  # of the truth, where MuJoCo begins
ITERATIONS, SOFT = 8, 1e-3


def population():
    """The script whose records these are."""
    spec = spec_from_file_location("population", HERE / "robots.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Judge:
    """What parameters are worth along a motion that no tool has seen."""

    def __init__(self, loop: iv.RobotLoop, record: iv.Record) -> None:
        sim = loop.simulate(record, initial="rest")
        rows = np.abs(sim.dq).min(axis=1) > 0.01
        self.motion = [x[rows][::20] for x in (sim.q, sim.dq, sim.ddq)]
        self.tau = self.ours(loop, loop.values(), *self.motion)
        self.mass = loop.mass_matrix(self.motion[0]).diagonal(axis1=1, axis2=2)

    @staticmethod
    def ours(loop: iv.RobotLoop, values: dict, q, dq, ddq) -> np.ndarray:
        """The torques of the loop's model, (n_samples, n_joints)."""
        X = loop.regressor(Motion(q, dq, ddq))
        return (X @ [values[n] for n in loop.names]).T

    def __call__(self, torque, loop: iv.RobotLoop) -> dict[str, float]:
        """Errors of a function from motion to torque, %."""
        q, dq, ddq = self.motion
        left = torque(q, dq, ddq) - self.tau
        share = np.sqrt(np.mean(left**2, axis=0) / np.mean(self.tau**2, axis=0))
        still, rest = np.zeros_like(q), torque(q, np.zeros_like(q), np.zeros_like(q))
        mass = []
        for j in range(q.shape[1]):
            one = still.copy()
            one[:, j] = 1.0
            mass.append((torque(q, still, one) - rest)[:, j])
        bias = np.mean(mass, axis=1) / self.mass.mean(axis=0) - 1.0
        return {"torque": 100.0 * share.max(), "mass": 100.0 * np.abs(bias).max()}


# --- the tools: from a csv to a function from motion to torque --------------------------------


def ivtools(path: Path, loop: iv.RobotLoop, method) -> tuple:
    """This library."""
    fit = method.fit(iv.Problem(iv.Record.read(path), loop))
    values = loop.values({str(k): float(v) for k, v in fit.params.items()})
    return lambda q, dq, ddq: Judge.ours(loop, values, q, dq, ddq)


def figaroh(path: Path, loop: iv.RobotLoop) -> tuple:
    """FIGAROH's weighted least squares."""
    import pinocchio
    from figaroh.identification import identification_tools as tools
    from figaroh.identification.base_identification import BaseIdentification
    from figaroh.identification.parameter import (
        add_standard_additional_parameters,
        get_standard_parameters,
    )
    from figaroh.tools import regressor
    from figaroh.tools.qrdecomposition import QRDecomposer

    class Robot:
        model = pinocchio.buildModelFromUrdf(str(URDF))
        data = model.createData()

    frame, n = pd.read_csv(path), Robot.model.nv
    signals = [frame[[f"{s}{j + 1}" for j in range(n)]].to_numpy() for s in ("q", "tau")]
    dt = float(np.diff(frame["t"]).mean())
    known = {
        "ts": dt, "cut_off_frequency_butterworth": 4.0 * HZ,  # its formula halves twice
        "has_friction": True, "has_actuator_inertia": True, "has_joint_offset": True,
        "is_joint_torques": True, "act_idxv": list(range(n)), "idx_act_joints": list(range(n)),
    }  # fmt: skip
    q, tau = (tools.low_pass_filter_data(x, known) for x in signals)
    q, dq, ddq = tools.calculate_first_second_order_differentiation(Robot.model, q, known)
    tau = tau[: len(q)]
    q, dq, ddq, tau = (x[::EVERY] for x in (q, dq, ddq, tau))
    names = get_standard_parameters(Robot.model, known)
    names |= add_standard_additional_parameters(Robot.model, known)
    W = regressor.build_regressor_basic(Robot, q, dq, ddq, known)
    gone, kept = regressor.get_index_eliminate(W, names, 1e-6)
    W = regressor.build_regressor_reduced(W, gone)
    decomposer = QRDecomposer()
    W_b, *_, phi, _ = decomposer.double_decomposition(tau.T.ravel(), W, kept, names)
    task = BaseIdentification.__new__(_concrete(BaseIdentification))
    task.phi_base = phi
    _, sigma = task._calculate_joint_variances(W_b, tau.T.ravel(), n)
    phi, _ = task._solve_weighted_least_squares(W_b, tau.T.ravel(), sigma)
    base = decomposer.get_base_indices()

    def torque(q, dq, ddq):
        rows = regressor.build_regressor_basic(Robot, q, dq, ddq, known)
        rows = regressor.build_regressor_reduced(rows, gone)[:, base]
        return (rows @ phi).reshape(n, -1).T

    return torque


def _concrete(base: type) -> type:
    """The class without what its robots would add."""
    return type("Plain", (base,), {name: None for name in base.__abstractmethods__})


def mujoco(path: Path, loop: iv.RobotLoop) -> tuple:
    """MuJoCo's sysid on rollouts of the closed loop."""
    import mujoco as mj
    from mujoco import sysid

    frame = pd.read_csv(path)
    names, bodies = loop.joints, [joint.link for joint in loop.robot.joints]
    spec = mj.MjSpec.from_file(str(URDF))
    spec.option.timestep, spec.option.integrator = 1e-3, mj.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= int(mj.mjtDisableBit.mjDSBL_CONTACT)
    spec.option.disableflags |= int(mj.mjtDisableBit.mjDSBL_LIMIT)
    true = loop.values()
    ctrl, params = [], sysid.ParameterDict()
    for j, name in enumerate(names):
        kp, kd = (loop.axes[j].controller.settings[k] for k in ("kp", "kd"))
        joint = spec.joint(name)
        joint.armature = START["mass"] * loop.axes[j].start["inertia"]
        joint.damping[0] = START["friction"] * true[f"{name}.viscous"]
        joint.stiffness = _first(joint.stiffness, SOFT)
        joint.frictionloss = START["friction"] * true[f"{name}.coulomb"]
        drive = spec.add_actuator(name=name, target=name, trntype=mj.mjtTrn.mjTRN_JOINT)
        drive.gainprm[0], drive.biastype = kp, mj.mjtBias.mjBIAS_AFFINE
        drive.biasprm[:3] = 0.0, -kp, -kd
        for what, kind in (("q", "JOINTPOS"), ("tau", "ACTUATORFRC")):
            of = mj.mjtObj.mjOBJ_JOINT if what == "q" else mj.mjtObj.mjOBJ_ACTUATOR
            spec.add_sensor(
                name=f"{what}{j + 1}", type=getattr(mj.mjtSensor, f"mjSENS_{kind}"), objtype=of,
                objname=name,
            )  # fmt: skip
        ref = frame[f"q_ref{j + 1}"].to_numpy()
        ctrl.append(ref + kd / kp * np.gradient(ref, 1e-3))
    for body in bodies:
        part = spec.body(body)
        part.mass *= START["mass"]
        _diagonal(part, START["mass"] * np.array(part.fullinertia))
    model = spec.compile()
    for body in bodies:
        kind, modifier = sysid.InertiaType.Pseudo, _body_setter(body)
        params.add(
            sysid.body_inertia_param(spec, model, body, inertia_type=kind, modifier=modifier)
        )
    for j, name in enumerate(names):
        for what, value, most in (
            ("armature", model.dof_armature[j], 5.0),
            ("damping", model.dof_damping[j], 5.0),
            ("frictionloss", model.dof_frictionloss[j], 5.0),
        ):
            modifier = _joint_setter(name, what)
            params.add(
                sysid.Parameter(f"{name} {what}", value, 0.0, most * value, modifier=modifier)
            )
        params.add(sysid.Parameter(f"{name} offset", 0.0, -5.0, 5.0, modifier=_offset(name)))
    t = frame["t"].to_numpy()
    wanted = [f"q{j + 1}" for j in range(len(names))], [f"tau{j + 1}" for j in range(len(names))]
    seen = frame[[s for pair in zip(*wanted, strict=True) for s in pair]].to_numpy()
    mapping = sysid.TimeSeries.compute_all_sensor_mapping(model)
    state = sysid.create_initial_state(model, frame[wanted[0]].to_numpy()[0])
    control = sysid.TimeSeries(
        t, np.column_stack(ctrl), sysid.TimeSeries.compute_all_control_mapping(model)
    )
    record = sysid.ModelSequences(
        "arm", spec, "record", state, control, sysid.TimeSeries(t, seen, mapping)
    )
    residual = sysid.build_residual_fn(models_sequences=[record])
    found, _ = sysid.optimize(params, residual, max_iters=ITERATIONS, verbose=False)
    model = sysid.apply_param_modifiers(found, spec)
    data = mj.MjData(model)

    def torque(q, dq, ddq):
        out = np.empty_like(q)
        for i in range(len(q)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[i], dq[i], ddq[i]
            mj.mj_inverse(model, data)
            out[i] = data.qfrc_inverse
        # inverse dynamics lets the friction take what the motion asks: added as a law
        return out + _dry(model, data, q, dq, ddq)

    return torque


def _diagonal(part, full: np.ndarray) -> None:
    """Write an inertia (xx, yy, zz, xy, xz, yz) about the body's own axes."""
    import mujoco as mj

    xx, yy, zz, xy, xz, yz = full
    values, R = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    R[:, 2] *= np.linalg.det(R)
    quat = np.zeros(4)
    mj.mju_mat2Quat(quat, R.ravel())
    part.fullinertia = [np.nan, 0.0, 0.0, 0.0, 0.0, 0.0]
    part.inertia, part.iquat = values, quat


def _body_setter(name: str):
    """As the tool's own, which fails from the second body on: it leaves the diagonal at 0."""
    from mujoco.sysid._src import model_modifier as tool

    def modifier(spec, param) -> None:
        pi, part = tool.pi_from_theta(param.value), spec.body(name)
        part.mass, part.ipos = pi[0], pi[1:4] / pi[0]
        S = tool.skew(part.ipos)
        J = pi[4:].reshape(3, 3) + part.mass * S @ S
        _diagonal(part, np.array([J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2]]))

    return modifier


def _first(old, value: float):
    """A number, or the first of the coefficients that newer versions have."""
    if np.ndim(old) == 0:
        return value
    new = np.array(old)
    new[0] = value
    return new


def _joint_setter(name: str, what: str):
    def modifier(spec, param) -> None:
        joint = spec.joint(name)
        if what == "damping":
            joint.damping[0] = float(param.value[0])
        else:
            setattr(joint, what, float(param.value[0]))

    return modifier


def _offset(name: str):
    """A constant torque on a joint: a spring so soft that its ends are far away."""

    def modifier(spec, param) -> None:
        spec.joint(name).springref = -float(param.value[0]) / SOFT

    return modifier


def _dry(model, data, q, dq, ddq) -> np.ndarray:
    """What MuJoCo's inverse dynamics has of dry friction, replaced by Coulomb's."""
    import mujoco as mj

    out = np.empty_like(q)
    for i in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[i], dq[i], ddq[i]
        mj.mj_inverse(model, data)
        out[i] = data.qfrc_constraint + model.dof_frictionloss * np.sign(dq[i])
    return out


TOOLS = {
    "ivtools": {
        f"ivtools {m.key}": lambda path, loop, m=m: ivtools(path, loop, m)
        for m in (iv.IDIMWLS(), iv.IDIMIV())
    },
    "figaroh": {"figaroh wls": figaroh},
    "mujoco": {"mujoco sysid": mujoco},
}


def main() -> None:
    """Run the tools."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--tools", nargs="+", default=["ivtools", "figaroh", "mujoco"])
    given = parser.parse_args()
    records = population()
    loop, rows = records.ARMS["six"](), []
    t, q_ref = records.reference(20.0, n=6, seed=99)
    judge = Judge(loop, records.plan(t, q_ref))
    for seed in range(given.seeds):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "log.csv"
            records.measured(loop, NOISE, seed).to_frame().to_csv(path, index=False)
            for tool in given.tools:
                for name, run in TOOLS[tool].items():
                    start, clock = process_time(), time()
                    torque = run(path, loop)
                    used = {"seconds": process_time() - start, "clock": time() - clock}
                    rows.append({"tool": name, "seed": seed, **judge(torque, loop), **used})
                    print(rows[-1], flush=True)
                    old = pd.read_csv(RESULTS) if RESULTS.exists() else pd.DataFrame()
                    table = pd.concat([old, pd.DataFrame(rows[-1:])])
                    table.to_csv(RESULTS, index=False, float_format="%.4g")


if __name__ == "__main__":
    main()
