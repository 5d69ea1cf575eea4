"""A robot: a tree of joints, and the standard parameters of the links they carry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import AxisError, ShapeError
from . import dynamics
from .inertia import STANDARD, body, described, moved, pseudo_inertia, standard

Array = NDArray[np.float64]

HEAVIEST = 1e9  # number of a body: kg, kg m or kg m2
EARTH = (0.0, 0.0, -9.81)


@dataclass(frozen=True)
class Joint:
    """A joint with one degree of freedom, along or about the z-axis of its link's frame.

    Parameters
    ----------
    name, link : str
        Of the joint, and of the link that it moves.
    kind : str
        ``"revolute"`` (continuous ones too) or ``"prismatic"``.
    parent : int
        Joint that carries it, -1 for the base.
    rotation, position : (3, 3), (3,) ndarray
        Frame of its link in that of the parent's, at joint position 0; m.
    lower, upper, speed, effort : float
        Limits of position (rad or m), speed and torque or force; infinite where there is none.
    damping, friction, armature : float
        What the file says of them: N m s/rad, N m, kg m2 (or N s/m, N, kg).
    """

    name: str
    link: str
    kind: str
    parent: int
    rotation: Array
    position: Array
    lower: float = -inf
    upper: float = inf
    speed: float = inf
    effort: float = inf
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0


@dataclass(frozen=True)
class Place:
    """Where a link of the file sits: on joint `joint` (-1: base), displaced in its frame."""

    joint: int
    rotation: Array
    position: Array


@dataclass(frozen=True, eq=False)
class Robot:
    """A tree of revolute and prismatic joints on a fixed base.

    Frames follow the field's habit: the z-axis of a link's frame is the axis of its joint. Links
    that do not move against each other are one link here.

    Parameters
    ----------
    name : str
    joints : tuple of Joint
        Parents before their children: the order of the columns of a record.
    inertias : (n, 10) ndarray
        Standard parameters of each joint's link, `inertia.STANDARD`, about its frame; SI.
    gravity : (3,) tuple
        In the base frame, m/s2.
    places : mapping of str to Place
        Where the links of the file are.
    notes : tuple of str
        What the file says that a reader should know.

    Examples
    --------
    >>> import ivtools as iv
    >>> robot = iv.Robot.six_axis()
    >>> robot.n_joints, robot.joints[1].kind
    (6, 'revolute')
    """

    name: str
    joints: tuple[Joint, ...]
    inertias: Array
    gravity: tuple[float, float, float] = EARTH
    places: Mapping[str, Place] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        worst = int(np.argmax(np.abs(self.inertias).max(axis=1, initial=0.0)))  # a NaN first
        if not np.abs(self.inertias[worst]).max(initial=0.0) <= HEAVIEST:
            raise AxisError(
                f"the link of joint {self.joints[worst].name} has mass, moments or inertia of "
                f"{np.abs(self.inertias[worst]).max():.3g} (SI), its tool with it; no body is "
                f"larger than {HEAVIEST:g}"
            )

    # --- where it comes from -------------------------------------------------------------------

    @classmethod
    def from_urdf(cls, path: str | Path, joints: Sequence[str] | None = None) -> Robot:
        """Read a URDF file.

        Parameters
        ----------
        path : str or Path
        joints : sequence of str, optional
            Joints that move, in any order; the others are held at 0. Default: all that can.

        Raises
        ------
        AxisError
            If the file cannot be read or is no URDF; a floating or planar joint, a closed chain,
            a mimic joint among those that move; an unknown joint; a joint that moves no mass.
        """
        from .urdf import read

        return read(path, joints)

    @classmethod
    def from_mjcf(cls, path: str | Path, joints: Sequence[str] | None = None) -> Robot:
        """Read a MuJoCo model, by MuJoCo itself (extra ``mujoco``); else as `from_urdf`.

        Raises
        ------
        MissingExtraError
            If MuJoCo is not installed.
        AxisError
            As for `from_urdf`; free and ball joints, equality constraints and tendons' too.
        """
        from .mjcf import read

        return read(path, joints)

    @classmethod
    def six_axis(cls) -> Robot:
        """Return the generic six-joint arm that comes with the library."""
        return cls.from_urdf(Path(__file__).parent / "six_axis.urdf")

    # --- what it is ------------------------------------------------------------------------------

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name for joint in self.joints)

    @property
    def standard_names(self) -> tuple[str, ...]:
        """Names of the standard parameters, ``XX1`` for the first link, link by link."""
        return tuple(f"{p}{i}" for i in range(1, self.n_joints + 1) for p in STANDARD)

    @cached_property
    def tree(self) -> dynamics.Tree:
        """The geometry, as the compiled functions take it."""
        return dynamics.Tree(
            np.array([j.parent for j in self.joints], dtype=np.int64),
            np.array([j.kind == "prismatic" for j in self.joints]),
            np.array([j.rotation for j in self.joints], dtype=float),
            np.array([j.position for j in self.joints], dtype=float),
            np.array(self.gravity, dtype=float),
        )

    def joint(self, name: str) -> int:
        """Return the index of a joint.

        Raises
        ------
        AxisError
            If there is none of this name.
        """
        if name not in self.names:
            raise AxisError(f"robot has no joint {name!r}; its joints: {', '.join(self.names)}")
        return self.names.index(name)

    def links(self, inertias: ArrayLike | None = None) -> dict[str, dict[str, object]]:
        """Return mass, centre of mass and inertia about it per link, in the link's own frame.

        Parameters
        ----------
        inertias : (n, 10) array_like, optional
            Standard parameters; default: the robot's own.
        """
        phi = self._inertias(inertias)
        found = {}
        for i, joint in enumerate(self.joints):
            place = self.places[joint.link]
            P = moved(pseudo_inertia(phi[i].tolist()), place.rotation.T, np.zeros(3))
            found[joint.link] = described(standard(P))
        return found

    def with_gravity(self, gravity: tuple[float, float, float]) -> Robot:
        """Return this robot mounted another way: gravity in its base frame, m/s2."""
        return replace(self, gravity=gravity)

    def with_tool(
        self,
        link: str,
        mass: float,
        com: ArrayLike = (0.0, 0.0, 0.0),
        inertia: ArrayLike | None = None,
    ) -> Robot:
        """Return this robot with a tool or payload on a link.

        Parameters
        ----------
        link : str
            Any link of the file, fixed ones included.
        mass : float
            kg.
        com : (3,) array_like
            Centre of mass in the link's frame, m.
        inertia : (3, 3) array_like, optional
            About the centre of mass, kg m2; default: a point.

        Raises
        ------
        AxisError
            If there is no such link, or these are not the numbers of a body.
        """
        if link not in self.places:
            raise AxisError(f"robot has no link {link!r}; its links: {', '.join(self.places)}")
        at = self.places[link]
        tensor = np.zeros((3, 3)) if inertia is None else np.asarray(inertia, dtype=float)
        if not np.array_equal(tensor, tensor.T):  # NaN neither
            raise AxisError(f"tool inertia is {tensor.tolist()}; it must be symmetric")
        if not mass >= 0.0:
            raise AxisError(f"tool mass is {mass:g} kg; it must not be negative")
        P = moved(body(mass, np.asarray(com, dtype=float), tensor), at.rotation, at.position)
        phi = np.array(self.inertias)
        if at.joint >= 0:  # what sits on the base is not felt
            phi[at.joint] += standard(P)
        return replace(self, inertias=phi)

    # --- its dynamics ----------------------------------------------------------------------------

    def torques(
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, inertias: ArrayLike | None = None
    ) -> Array:
        """Return the inverse dynamics, (n_samples, n_joints), N m or N; links only.

        Parameters
        ----------
        q, dq, ddq : (n_samples, n_joints) array_like
            Positions, velocities, accelerations of the joints.
        inertias : (n, 10) array_like, optional
            Standard parameters; default: the robot's own.
        """
        q, dq, ddq = self._signals(q, dq, ddq)
        out = np.empty_like(q)
        dynamics.torques(self.tree, self._inertias(inertias), q, dq, ddq, out)
        return out

    def regressor(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        columns: NDArray[np.int64] | None = None,
        n_columns: int = 0,
    ) -> Array:
        """Return the observation matrix, (n_samples, n_joints, n_columns).

        Parameters
        ----------
        q, dq, ddq : (n_samples, n_joints) array_like
        columns : (n, 10) ndarray of int, optional
            Column of each standard parameter, -1 to leave it out; default: all, link by link.
        n_columns : int, optional
            At least so many; those that no parameter has are 0.
        """
        q, dq, ddq = self._signals(q, dq, ddq)
        if columns is None:
            columns = np.arange(10 * self.n_joints).reshape(-1, 10)
        out = np.zeros((*q.shape, max(int(columns.max(initial=-1)) + 1, n_columns)))
        dynamics.observations(self.tree, columns, q, dq, ddq, out)
        return out

    def mass_matrix(self, q: ArrayLike, inertias: ArrayLike | None = None) -> Array:
        """Return the mass matrix of the links, (n_samples, n, n), kg m2 (kg, kg m)."""
        (q,) = self._signals(q)
        out = np.empty((*q.shape, self.n_joints))
        dynamics.mass_matrices(self.tree, self._inertias(inertias), q, out)
        return out

    def gravity_torques(self, q: ArrayLike, inertias: ArrayLike | None = None) -> Array:
        """Return the torques that hold the links at rest, (n_samples, n_joints), N m or N."""
        (q,) = self._signals(q)
        return self.torques(q, np.zeros_like(q), np.zeros_like(q), inertias)

    def _inertias(self, inertias: ArrayLike | None) -> Array:
        phi = np.ascontiguousarray(self.inertias if inertias is None else inertias, dtype=float)
        if phi.size != 10 * self.n_joints:
            raise ShapeError(
                f"inertias are {phi.shape}; {self.n_joints} joints need ({self.n_joints}, 10)"
            )
        return phi.reshape(-1, 10)

    def _signals(self, *signals: ArrayLike) -> list[Array]:
        arrays = [np.ascontiguousarray(np.atleast_2d(x), dtype=float) for x in signals]
        for x in arrays:
            if x.shape != arrays[0].shape or x.shape[1] != self.n_joints:
                raise ShapeError(
                    f"a signal is {x.shape}; robot {self.name!r} has {self.n_joints} joints, so "
                    f"give (n_samples, {self.n_joints})"
                )
        return arrays
