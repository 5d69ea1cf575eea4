"""Monte-Carlo studies: every estimator on the same simulated records, scored against the truth."""

from ivtools.study.case import Case as Case
from ivtools.study.named import NAMES as NAMES
from ivtools.study.named import load as load
from ivtools.study.reference import BangBang as BangBang
from ivtools.study.reference import Multisine as Multisine
from ivtools.study.reference import Recorded as Recorded
from ivtools.study.reference import Trapezoids as Trapezoids
from ivtools.study.run import Study as Study
from ivtools.study.score import Score as Score
from ivtools.study.table import COLUMNS as COLUMNS
from ivtools.study.table import MEASURED as MEASURED
from ivtools.workers import Progress as Progress
