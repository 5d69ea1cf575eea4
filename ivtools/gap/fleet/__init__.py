"""Fleet: the diagnoses of many records, in parallel and resumable.

A source becomes a record, a record an entry, and entries a fleet; the shelf keeps what is finished.
"""

from .entry import Entry
from .fleet import Fleet
from .run import diagnose_fleet

__all__ = ["Entry", "Fleet", "diagnose_fleet"]
