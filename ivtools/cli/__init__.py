"""The command line: one module per verb; each parses, calls the library and prints.

Exit status: 0 done, 2 the input is at fault (one line on stderr), 1 anything else.
"""

from __future__ import annotations

from ivtools.cli.app import app, main, run

__all__ = ["app", "main", "run"]
