"""Attribute: which of the effects are named, and how sure that is.

rounds       one more effect is looked for
evidence     what speaks for its name, and the probability that it is right
kept         how many names stay where a force without a name may explain as much
attribution  what got a name, and what speaks for it
selection    forward over the rounds, and backward over what a later one made superfluous
"""

from .attribution import Attribution, Supposed
from .evidence import Evidence, features, probability
from .selection import attribute, upheld

__all__ = ["Attribution", "Evidence", "Supposed", "attribute", "features", "probability", "upheld"]
