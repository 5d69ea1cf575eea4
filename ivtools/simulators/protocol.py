"""What a simulator is: something that follows a record's reference and logs what it did."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ivtools.errors import DataError, IVToolsError
from ivtools.record import Record

if TYPE_CHECKING:
    from ivtools.loop import Simulation


class Simulator(ABC):
    """Anything that simulates the closed loop on the reference of a record.

    `ivtools.ClosedLoop` is one; `from_function` makes one of any Python function, and
    `ivtools.MujocoSimulator` one of a MuJoCo model.

    Attributes
    ----------
    parameters : mapping
        What the simulator calls its parameters.
    units : mapping
        Their units.
    """

    parameters: Mapping[str, Any]
    units: Mapping[str, str]

    @abstractmethod
    def simulate(self, record: Record) -> Record | Simulation:
        """Return what the simulated axis did on this record's reference.

        A simulator may also have ``simulate_changed(record, found)``, which does the same with the
        changes of a `Diagnosis` made.
        """

    @classmethod
    def __subclasshook__(cls, other: type) -> Any:
        """Count every class with these three members as a simulator."""
        known = all(hasattr(other, name) for name in ("simulate", "parameters", "units"))
        return True if cls is Simulator and known else NotImplemented

    @staticmethod
    def from_function(
        function: Callable[[Record], Any],
        parameters: Mapping[str, float] | None = None,
        units: Mapping[str, str] | None = None,
        change: Callable[[Any], Callable[[Record], Any]] | None = None,
    ) -> FunctionSimulator:
        """Make a simulator of a function.

        Parameters
        ----------
        function : callable
            Takes a `Record`, follows its reference (and its added input), and returns what it
            did: a Record, a DataFrame, or a mapping of ``t``, ``q``, ``nu`` or ``tau`` to arrays,
            (n_samples,) each, in SI.
        parameters, units : mapping, optional
            What the simulator calls its parameters, and their units.
        change : callable, optional
            Takes a `Diagnosis` and returns the function with its changes made: a diagnosis then
            says what they bring.

        Examples
        --------
        >>> import ivtools as iv
        >>> loop = iv.axes.emps()
        >>> theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": 0.0}
        >>> mine = iv.Simulator.from_function(
        ...     lambda record: {"t": record.t, **follow(record)}, theta
        ... )
        >>> def follow(record):
        ...     done = loop.simulate(record, theta)
        ...     return {"q": done.q, "nu": done.nu}
        >>> mine.simulate(iv.datasets.twin()).n_joints
        1
        """
        return FunctionSimulator(function, dict(parameters or {}), dict(units or {}), change)


@dataclass(frozen=True)
class FunctionSimulator(Simulator):
    """A simulator that is a function of a record; see `Simulator.from_function`."""

    function: Callable[[Record], Any]
    parameters: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    change: Callable[[Any], Callable[[Record], Any]] | None = None

    def simulate(self, record: Record) -> Record:
        """Return what the function says of this record, with the record's own reference.

        Raises
        ------
        DataError
            If what comes back is not a log of the same reference.
        """
        return logged(self.function(record), record)

    def simulate_changed(self, record: Record, found: Any) -> Record:
        """Return what the function says once the changes of a `Diagnosis` are made in it.

        Raises
        ------
        DataError
            If what comes back is no log, or `change` was not given.
        """
        if self.change is None:
            raise DataError("make them in your simulator; from_function(change=) lets us try")
        return logged(self.change(found)(record), record)


def logged(done: Any, record: Record) -> Record:
    """Return what a simulator gave as a record on the reference of the record that drove it.

    Parameters
    ----------
    done : Record, Simulation, DataFrame or mapping
    record : Record

    Raises
    ------
    DataError
        If it has no position, or neither command nor force.
    """
    if isinstance(done, Record):
        return done
    name = f"{record.name}, simulated"
    own = {"q_ref": record.q_ref, "dq_ref": record.dq_ref, "added": record.added}
    known = {key: value for key, value in own.items() if value is not None}
    try:
        if hasattr(done, "to_record"):
            return done.to_record(name=name).replace(**known)
        table = {str(key): done[key] for key in done}
        return Record.from_dict({"t": record.t, **known, **table}, name=name)
    except (TypeError, KeyError) as error:
        raise DataError(
            f"the simulator gave a {type(done).__name__}; give a Record, a DataFrame, or a mapping "
            "of t, q and nu (or tau) to arrays"
        ) from error
    except IVToolsError as error:
        raise type(error)(f"the simulator's log: {error}") from error
