"""Methods: their names, known before anything heavy is imported."""

from ivtools.errors import EstimationError

METHODS = {
    "idim-ls": "least_squares:IDIMLS",
    "idim-wls": "least_squares:IDIMWLS",
    "idim-iv": "instrumental:IDIMIV",
    "idim-bciv": "compensated:IDIMBCIV",
    "idim-piv": "refined:IDIMPIV",
    "ml": "maximum_likelihood:ML",
    "set-membership": "set_membership:SetMembership",
    "lmi-ls": "constrained:LMILS",
    "lmi-iv": "constrained:LMIIV",
    "didim": "input_error:DIDIM",
    "clie": "input_error:CLIE",
    "cloe": "output_error:CLOE",
    "oloe": "output_error:OLOE",
    "ddm-ls": "direct:DDMLS",
    "ddm-iv": "direct:DDMIV",
    "nsga2": "multi_objective:NSGA2",
}
"""Method names of the command line, each with its module and class in `ivtools.estimators`."""

FUNCTIONS = {
    "srivc": "transfer_function:SRIVC",
    "rivc": "box_jenkins:RIVC",
    "clsrivc": "closed_loop_srivc:CLSRIVC",
    "sriv": "box_jenkins:SRIV",
    "rivbj": "box_jenkins:RIVBJ",
}
"""The same for the methods whose result is a transfer function, see `functions`."""


def method(key: str) -> str:
    """Return the module and class of a method with physical parameters.

    Raises
    ------
    EstimationError
        It is another, or none.
    """
    if key in FUNCTIONS:
        raise EstimationError(
            f"{key} gives a transfer function, which has no physical parameters; run compare with "
            f"--methods {key}"
        )
    if key not in METHODS:
        known = ", ".join([*METHODS, *FUNCTIONS])
        raise EstimationError(f"method {key!r} is unknown; use one of {known}")
    return METHODS[key]
