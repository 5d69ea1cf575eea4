"""Page: a diagnosis for people, from the answer to the figures behind it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import isfinite
from typing import TYPE_CHECKING, Literal

from ..tables import Text, sentence, table
from ..units import JOINTS, percent, quantity
from .simulator import changes_table
from .verdict import SCREENED

if TYPE_CHECKING:
    from ..plots.chart import Chart
    from ..plots.gap import Drawn
    from ..report import Card, Page, Picture
    from .diagnosis import Diagnosis
    from .discrepancy import Discrepancy
    from .quantify import Shrink
    from .verdict import Replica

_NEXT = 4  # lines of advice on the card
_TONES: dict[str, Literal["good", "doubt", "bad"]] = {
    "adequate": "good",
    "explained": "good",
    "unexplained": "bad",
}
_RECORD = (
    "Force measured and simulated before and after, their error, position and velocity; shaded: "
    "single stretches far above the noise."
)
_RECORD_ALONE = (
    "Force measured and simulated, its error, position and velocity; shaded: single stretches far "
    "above the noise."
)
_WHERE = (
    "What counts: not the transient at the start, the command at a limit that the axis file has, "
    "standstill, or, of one record alone, the stretches that the effects were fitted to."
)
_OF_LITTLE = "What each effect would close of the little that is above the floor"
_ASKED = {
    "adequate": "Use the model as it is.",
    "unexplained": "See below where the error sits; an effect of your own can take part (extra).",
    "non-repeatable": "Record the same motion again, with nothing changed in between.",
}
_REPLICATES = {True: "yes", False: "no", None: "not compared"}


def page(diagnosis: Diagnosis) -> Page:
    """Return the page of a diagnosis.

    Parameters
    ----------
    diagnosis : Diagnosis
    """
    from ..plots import gap as figures
    from ..report import Page

    out = Page(f"Diagnosis of {diagnosis.name}", _lead(diagnosis), _card(diagnosis))
    shown = _named(diagnosis)
    if diagnosis.changes:
        shown.append(changes_table(diagnosis.changes))
    out.add("The answer", *_answer(diagnosis), tables=shown)
    if diagnosis.traces is None or diagnosis.shrink is None:
        return out
    about = _RECORD if diagnosis.effects else _RECORD_ALONE
    out.add("The record", figures=[figures.over_time(diagnosis, "record", about)])
    drawn = partial(_drawn, diagnosis)
    out.add("Where", _WHERE, figures=drawn(figures.WHERE))
    said = [*map(sentence, diagnosis.said_of_beside), *_nothing(diagnosis)]
    said += [sentence(SCREENED)] if any(not r.held_out for r in diagnosis.first) else []
    ranked, folded = _ranked(diagnosis)
    which = drawn(figures.WHICH) if ranked else []
    out.add("Which effect", *said, tables=ranked, figures=which, folded=folded)
    if (left := diagnosis.nameless) is not None:
        shown, curve = [_nameless_table(diagnosis, left)], figures.nameless_of(diagnosis)
        out.add("What has no name", _nameless(left), tables=shown, figures=drawn(curve))
    out.add("How far", tables=[_signals(diagnosis)], figures=drawn(figures.HOW_FAR))
    if rest := _remarks(diagnosis)[_NEXT:]:
        out.add("More remarks", *rest)
    return out


def _drawn(diagnosis: Diagnosis, what: Sequence[Drawn], prefix: str = "") -> list[Picture]:
    """Return the figures of a section, with their captions."""
    from ..report import Picture

    return [Picture(f"{prefix}{name}", draw(diagnosis), caption) for name, draw, caption in what]


def add_joint(out: Page, title: str, diagnosis: Diagnosis, figure: str) -> None:
    """Add the diagnosis of a robot's joint to a page: answer, forces, ranking, remarks.

    Parameters
    ----------
    out : Page
    title : str
        Of the section.
    diagnosis : Diagnosis
    figure : str
        Name of its chart.
    """
    from ..plots import gap as figures

    verdict = f"{diagnosis.verdict.capitalize()}: {diagnosis.why}."
    ranked: list[Text] = []
    folded: list[tuple[str, Text]] = []
    charts: list[Picture | Chart] = []
    if diagnosis.traces is not None and diagnosis.shrink is not None:
        ranked, folded = _ranked(diagnosis)
        about = _RECORD if diagnosis.effects else _RECORD_ALONE
        charts.append(figures.over_time(diagnosis, figure, about))
    charts += _drawn(diagnosis, figures.nameless_of(diagnosis), f"{figure}-")
    remarks = map(sentence, diagnosis.advice)
    out.add(
        title,
        verdict,
        *_answer(diagnosis),
        *remarks,
        tables=[*_named(diagnosis), *ranked],
        figures=charts,
        folded=folded,
    )


def _answer(diagnosis: Diagnosis) -> list[str]:
    """Return the gap in words, and what is to be known besides."""
    more = (*(f.text for f in diagnosis.findings), *_more(diagnosis))
    return [*gap_text(diagnosis), *map(sentence, more)]


def _named(diagnosis: Diagnosis) -> list[Text]:
    """Return the table of what is named, if anything is."""
    return [named_table(diagnosis)] if diagnosis.replicas else []


def _ranked(diagnosis: Diagnosis) -> tuple[list[Text], list[tuple[str, Text]]]:
    """Return the ranking, to be shown or, if it is shares of next to nothing, to be folded."""
    ranked = ranking_table(diagnosis)
    return ([], [(_OF_LITTLE, ranked)]) if diagnosis.verdict == "adequate" else ([ranked], [])


def _lead(diagnosis: Diagnosis) -> str:
    """Return which model is set against which records."""
    sides = next((r.sides for r in diagnosis.replicas), None)
    s = diagnosis.shrink
    if s is not None and s.held_out and sides is not None:
        return f"{diagnosis.loop.name} against {sides[0]}, judged on {sides[1]}."
    return f"{diagnosis.loop.name} against {diagnosis.name}."


def _remarks(diagnosis: Diagnosis) -> list[str]:
    """Return what to know or to do, the most important first."""
    found = sorted(diagnosis.findings, key=lambda f: not f.fatal)
    return [sentence(text) for text in (*(f.text for f in found), *diagnosis.advice)]


def _more(diagnosis: Diagnosis) -> list[str]:
    """Return what differs between records, what is left without a name, and what changes bring."""
    lines = [change.said(name) for name, change in diagnosis.changed.items()]
    if diagnosis.nameless is not None:
        lines.append(f"what is left: {diagnosis.nameless.text}")
    if diagnosis.confirmed is not None:
        lines.append(diagnosis.confirmed.text)
    s = diagnosis.shrink
    if s is not None and s.judged is not None:
        lines.append(s.judged.said(s.unit))
    return lines


def _nameless(left: Discrepancy) -> str:
    """Return how to read the figures of a force without a name."""
    return (
        f"The force repeats over {left.said}. A {left.law}, fitted to one part of the data and put "
        f"into the model, leaves {left.leaves} of the force error on the other part: so far at "
        "least a law without a name closes the gap that is left."
    )


def _nameless_table(diagnosis: Diagnosis, left: Discrepancy) -> Text:
    """Return the size of a force without a name, and the force errors without and with it."""
    sizes = {
        "the force, rms": left.rms,
        "force error without it, rms": left.before,
        "force error with it, rms": left.after,
    }
    rows = [[name, quantity(size, left.unit, 3)] for name, size in sizes.items()]
    if left.period:
        rows.append(["its period", quantity(left.period, JOINTS[diagnosis.loop.joint].length, 3)])
    return table("A force without a name", [], ["quantity", "value"], rows)


def _card(diagnosis: Diagnosis) -> Card:
    """Return the answer in short: verdict, effects with their values, errors, what to do next."""
    from ..report import Card

    s = diagnosis.shrink
    facts = [("Effects", text) for text in effects_text(diagnosis)]
    if s is not None and not facts:
        facts = [("Effects", "none is named")]
    if s is not None:
        if diagnosis.negligible:
            facts.append(("Gap", diagnosis.size))
        both = (s.before, s.after) if s.shown(s.after) != s.shown(s.before) else (s.before,)
        errors = " → ".join(s.shown(x) if isfinite(x) else "diverges" for x in both)
        shares = " → ".join(percent(x / s.force) for x in both if isfinite(x))
        facts.append(("Force error, rms", f"{errors}; {shares} of the force"))
        if s.held_out:
            frozen = s.shown(s.after_frozen)
            facts.append(("With the first record's base parameters", frozen))
        if (left := diagnosis.nameless) is not None:
            facts.append((f"With a {left.law} besides", left.leaves))
        facts.append(("Floor", s.shown(s.floor)))
    verdict = f"{diagnosis.verdict.capitalize()}: {diagnosis.why}."
    tone = _TONES.get(diagnosis.verdict, "doubt")
    if s is None and facts:
        verdict = "Nothing could be simulated, but this shows all the same."
    elif s is None:
        verdict, tone = "No answer: the record or the axis file must be looked at first.", "bad"
    if diagnosis.confirmed is not None:
        facts.append(("Your simulator", diagnosis.confirmed.text.removeprefix("your simulator ")))
    remarks = _remarks(diagnosis)[:_NEXT]
    return Card(verdict, tuple(facts), (*_next(diagnosis), *remarks), tone)


def _next(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return what the verdict itself asks for; a fault of the input says so in its remark."""
    if diagnosis.shrink is None:
        return ()
    if diagnosis.changes:
        return ("Make the changes below in your simulator; ivtools export writes them.",)
    if diagnosis.shrink.put_right and not diagnosis.effects:
        return ("Put the controller of the axis file right first: the remarks say how.",)
    if diagnosis.effects:
        return ("Put what is named into your model; ivtools export writes it for other tools.",)
    return (_ASKED[diagnosis.verdict],) if diagnosis.verdict in _ASKED else ()


def _fitted(replica: Replica, name: str) -> str:
    """Return a parameter's value on the side that it was fitted to, or else on the other."""
    return replica.value(name, 0 if replica.values[name][0] is not None else 1)


def effects_text(diagnosis: Diagnosis) -> list[str]:
    """Return each named effect with its values, how sure it is, and what it may also be."""
    texts = []
    for effect in diagnosis.effects:
        replica = next((r for r in diagnosis.replicas if r.effect == effect), None)
        known = replica.values if replica else diagnosis.parameters.get(effect, {})
        of = partial(_fitted, replica) if replica else partial(diagnosis.value, effect)
        values = ", ".join(f"{k} {of(k)}" for k in known)
        text = f"{effect}: {values}" if values else effect
        if effect in diagnosis.probability:
            text += diagnosis.chance(effect)
        twins = " or ".join(diagnosis.ambiguous_with.get(effect, ()))
        texts.append(f"{text}; may also be {twins}" if twins else text)
    return texts


def gap_text(diagnosis: Diagnosis) -> list[str]:
    """Return the gap before and after in a sentence or two."""
    s = diagnosis.shrink
    if s is None:
        return ["Nothing was simulated: the record or the axis file must be looked at first."]
    judge = "another record" if s.held_out else "stretches of the record that they were not fitted"
    floor = s.shown(s.floor)
    text = (
        f"The simulated force is {s.shown(s.before)} rms off the measured one, "
        f"{percent(s.before / s.force)} of the force"
    )
    text = "The simulation as the axis file has it diverges" if s.diverges else text
    if small := diagnosis.small:
        text = f"{small.capitalize()}: {text[0].lower()}{text[1:]}"
    if not diagnosis.effects:
        text += f",{_controller(s)} and the floor, which no model could go below, is {floor}."
        return [text + _handed_over(s)]
    return [
        f"{text},{_controller(s)} and {s.shown(s.after, s.interval)} (95 % interval) with "
        f"the named effects, judged on {judge}{'' if s.held_out else ' to'}. The floor is {floor}, "
        f"so {round(100 * s.closed)} % of what a model can close is closed.{_handed_over(s)}"
    ]


def _handed_over(s: Shrink) -> str:
    """Return what the model leaves that is handed over, its base parameters not tuned again."""
    if not s.held_out:
        return ""
    frozen = s.shown(s.after_frozen, s.interval_frozen)
    return f" With the first record's base parameters it is {frozen}."


def _nothing(diagnosis: Diagnosis) -> list[str]:
    """Return why there is no name, if there is none."""
    if diagnosis.effects:
        return []
    if diagnosis.verdict == "adequate":
        return ["Nothing is named: what is left is within the noise, or negligible."]
    best = next(iter(diagnosis.ranking), None)
    said = ["Nothing is named: no known effect passed every test on held-out data."]
    if best is not None:
        most = f"{best.effect} {100 * best.closed:.0f} % the most"
        said.append(f"What each closes by itself is listed all the same, {most}.")
    return [" ".join(said)]


def _controller(s: Shrink) -> str:
    """Return what putting the controller right is worth."""
    if not s.put_right:
        return ""
    return f" {s.shown(s.corrected)} with the controller put right,"


def named_table(diagnosis: Diagnosis) -> Text:
    """Return the named effects, their values on either side, and whether they replicate."""
    one, two = diagnosis.replicas[0].sides
    rows: list[Sequence[str]] = []
    for replica in diagnosis.replicas:
        twins = ", ".join(diagnosis.ambiguous_with.get(replica.effect, ())) or "-"
        chance = f"{100 * diagnosis.probability[replica.effect]:.0f} %"
        for k, name in enumerate(replica.values):
            agree = _REPLICATES[replica.replicates] + ", but for its size" * replica.resized
            first = (agree, twins, chance) if k == 0 else ("", "", "")
            label = replica.effect if k == 0 else ""
            rows.append([label, name, replica.value(name, 0), replica.value(name, 1), *first])
    header = [
        "effect",
        "parameter",
        f"on {one}",
        f"on {two}",
        "replicates",
        "may also be",
        "likely",
    ]
    return table("What is named", [], header, rows, left=2)


def ranking_table(diagnosis: Diagnosis) -> Text:
    """Return what each effect closes by itself, the most first."""
    rows = [[r.effect, f"{100 * r.closed:.0f} %", diagnosis.p_value(r)] for r in diagnosis.first]
    return table("Ranking", [], ["effect", "closes by itself", "p value"], rows)


def _signals(diagnosis: Diagnosis) -> Text:
    """Return the errors of every signal before and after."""
    s = diagnosis.shrink
    assert s is not None
    length = JOINTS[diagnosis.loop.joint].length
    units = {"position": length, "velocity": f"{length}/s", "acceleration": f"{length}/s²"}
    rows = [["force", s.shown(s.before), s.shown(s.after)]]
    for name, (before, after) in s.signals.items():
        shown = (quantity(x, units[name], 3) if isfinite(x) else "-" for x in (before, after))
        rows.append([name, *shown])
    header = ["signal", "before", "after"]
    if not diagnosis.effects:
        rows, header = [row[:2] for row in rows], ["signal", "error"]
    return table("Simulated against measured, rms", [], header, rows)
