"""Table of the verdicts of the loop, each with its sentences."""

from __future__ import annotations

from dataclasses import dataclass

FIELDS = ("model", "found", "doubt", "place", "change", "within")
"""Fields that a headline may hold in braces.

model: the initial model of the loop; found: the effects in clauses, each with its probability; doubt: the reason why
the verdict is not certain; place: the place of the remaining residual; change: the final value of the error that
carried the verdict; within: the noise level that the residual does not exceed.
"""


@dataclass(frozen=True)
class Verdict:
    """A verdict in words.

    Parameters
    ----------
    name : str
        Name in the JSON.
    sentence : str
        Meaning for a result with effects, or for any result if `plain` is empty.
    plain : str
        Meaning for a result without effects.
    headline : str
        Sentence for a result with effects, with `FIELDS` in braces. A semicolon separates its parts; a part whose
        fields are all empty is left out.
    bare : str
        The same for a result without effects.
    advice : str
        Advice on the use of the result, printed below the next test.
    colour, dark : str
        CSS colour of its mark on a light and on a dark page.
    provisional : bool
        Whether the effects of such a result are provisional: none of them is reported as found.
    certain : bool
        Whether the result may be used directly; if not, `cvxshear loop --strict` ends with status 3.
    """

    name: str
    sentence: str
    plain: str
    headline: str
    bare: str
    advice: str
    colour: str
    dark: str
    provisional: bool = False
    certain: bool = False

    def __post_init__(self) -> None:
        """Raise an error for an unknown field of a headline now, not in the first report."""
        nothing = dict.fromkeys(FIELDS, "")
        for text in (self.headline, self.bare):
            try:
                text.format(**nothing)
            except (KeyError, IndexError, ValueError) as error:
                raise ValueError(f"verdict {self.name!r}: {text!r} may name {', '.join(FIELDS)} in braces") from error

    def says(self, *, added: bool, **fields: str) -> str:
        """Write the headline of a result, without the full stop.

        Parameters
        ----------
        added : bool
            Whether the result has effects.
        **fields : str
            Text for each of `FIELDS`; empty if the result has none.
        """
        parts = (self.headline if added else self.bare).split("; ")
        given = [part for part in parts if "{" not in part or any(fields[n] for n in FIELDS if f"{{{n}}}" in part)]
        return "; ".join(" ".join(part.format(**fields).split()) for part in given)


_ALL = (
    Verdict(
        "adequate",
        "The shear model explains the data; nothing was added.",
        "",
        "{model} explains the data {within}; {doubt}",
        "{model} explains the data {within}; {doubt}",
        "Use the averaged masses and stiffnesses: their standard deviations allow for what else may be there.",
        "#00664a",
        "#4fc3a1",
        certain=True,
    ),
    Verdict(
        "explained",
        "The shear model alone does not explain the data; with the effects that were added it does.",
        "The shear model explains the data once the modes are numbered otherwise; nothing was added.",
        "{found}; {change}",
        "{model} explains the data; {change}",
        "Use the averaged masses and stiffnesses: their standard deviations allow for what else may be there.",
        "#00664a",
        "#4fc3a1",
        certain=True,
    ),
    Verdict(
        "ambiguous",
        "The data are explained with the effects that were added, but something else would explain them as well.",
        "The shear model explains the data, but so might something that these data cannot tell from it.",
        "{found}; but {doubt}; {change}",
        "{model} explains the data; but {doubt}; {change}",
        "Take what was found and its rivals as possible causes until a test distinguishes them.",
        "#8a5a00",
        "#e0b04a",
    ),
    Verdict(
        "located",
        "No cause in the catalogue explains the data, but which statement of the shear model fails is known.",
        "",
        "{found}; no cause in the catalogue accounts for it; {doubt}; {change}",
        "which statement of the shear model fails is known; no cause in the catalogue accounts for it; {change}",
        "Look at the place that is named; a cause of your own can be added as an effect.",
        "#5a3f94",
        "#b39ddb",
    ),
    Verdict(
        "unexplained",
        "A significant residual is left that no effect of the catalogue accounts for.",
        "",
        "a significant residual is left {place}; provisionally, {found}; {change}",
        "a significant residual is left {place}; no effect that was looked for accounts for it",
        "Check the measurement where the residual sits first; what is named is provisional.",
        "#a33a00",
        "#ff9a6b",
        provisional=True,
    ),
)

VERDICTS = {each.name: each for each in _ALL}
"""Verdicts of a loop by name; a new verdict is one more entry."""
