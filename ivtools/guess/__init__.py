"""From a stranger's log to an axis file: what its columns are, their units, the clock, the law.

Names say most (`words`), the shapes of the signals the rest (`roles`), what they are to each other
which units they have (`scales`). `first_axis` puts it together, and says how sure it is.
"""

from __future__ import annotations

from .first import FirstAxis, first_axis

__all__ = ["FirstAxis", "first_axis"]
