"""Numbers as people read them in a column."""

import re
from typing import Any

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
MINUS, NONE = "\N{MINUS SIGN}", "\N{EN DASH}"


def number(value: Any) -> str:
    """A value of at most four digits: 0.07292, 40, 1.332×10⁻⁸; yes or no; a dash for None."""
    if value is None:
        return NONE
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return str(value).replace("-", MINUS)
    if not isinstance(value, float):
        return str(value)
    rounded = float(f"{value:.4g}")
    if rounded != 0 and abs(rounded) < float("inf") and not 1e-3 <= abs(rounded) < 1e6:
        mantissa, _, exponent = f"{rounded:.3e}".partition("e")
        mantissa = mantissa.rstrip("0").rstrip(".")
        text = f"{mantissa}×10{str(int(exponent)).translate(_SUPERSCRIPT)}"
    else:
        text = f"{rounded:.0f}" if abs(rounded) >= 1e4 else f"{rounded:.4g}"
    return text.replace("-", MINUS)


def parts(text: str) -> tuple[str, str]:
    """A number up to its decimal point, and from there on: in a column the points meet."""
    whole = re.split(r"(?=[.×])", text, maxsplit=1)
    return whole[0], text[len(whole[0]) :]
