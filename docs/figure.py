"""Draw the figure of the README; `make figure` runs this."""

from pathlib import Path

import ivtools as iv

record, loop = iv.datasets.twin(), iv.axes.emps()
models = {
    "friction the same in both directions": loop,
    "friction of its own in each direction": loop.with_terms("inertia", "asymmetric-friction"),
}
fits = [iv.IDIMIV().fit(iv.Problem(record, model)) for model in models.values()]
figure = iv.plots.residuals(fits, labels=list(models))
iv.plots.save(figure, Path(__file__).parent / "figure.png", dpi=300)
