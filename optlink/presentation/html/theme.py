"""Colours of a page in light and in dark mode."""

import colorsys
import re
from collections.abc import Iterable

LIGHT, DARK = "#ffffff", "#15181c"
"""Backgrounds of the two modes."""
MIN_CONTRAST = 4.6  # least contrast of text (WCAG 2.1, level AA: 4.5)
BACKGROUND_LUMINANCE = 0.72  # relative luminance from which a colour is a background
_HEX = re.compile(r"#[0-9a-fA-F]{6}\b")


def luminance(colour: str) -> float:
    """Return the relative luminance of a colour "#rrggbb" (WCAG 2.1)."""
    parts = [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(colour: str, background: str) -> float:
    """Return the contrast ratio of two colours "#rrggbb" (WCAG 2.1), 1 to 21."""
    low, high = sorted((luminance(colour), luminance(background)))
    return (high + 0.05) / (low + 0.05)


def readable(colour: str, paper: str = LIGHT) -> str:
    """Return a colour "#rrggbb", if necessary darker or lighter, that can be read on a background."""
    hue, light, saturation = _hls(colour)
    step = -0.01 if luminance(paper) > 0.5 else 0.01
    while contrast(colour, paper) < MIN_CONTRAST and 0.0 <= light <= 1.0:
        light += step
        colour = _hex(hue, min(max(light, 0.0), 1.0), saturation)
    return colour


def dark(colour: str) -> str:
    """Return the colour of dark mode: a background tint becomes a dark one, any other colour stays readable."""
    hue, light, saturation = _hls(colour)
    if luminance(colour) < BACKGROUND_LUMINANCE:
        ink = saturation < 0.25 and contrast(colour, LIGHT) > 2.0 * MIN_CONTRAST  # nearly black becomes nearly white
        return readable(_hex(hue, 1.0 - 0.7 * light, saturation) if ink else colour, DARK)
    return DARK if colour.lower() == LIGHT else _hex(hue, 0.11 + 0.7 * (1.0 - light), 0.4 * saturation)


def palette(texts: Iterable[str]) -> dict[str, str]:
    """Return the dark counterpart of every colour "#rrggbb" in texts."""
    return {colour: dark(colour) for colour in sorted({match for text in texts for match in _HEX.findall(text)})}


def variable(text: str) -> str:
    """Replace every colour "#rrggbb" of a drawing by a CSS variable with this colour as default."""
    return _HEX.sub(lambda match: f"var(--c{match[0][1:]}, {match[0]})", text)


def _hls(colour: str) -> tuple[float, float, float]:
    return colorsys.rgb_to_hls(*(int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)))


def _hex(hue: float, light: float, saturation: float) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in colorsys.hls_to_rgb(hue, light, saturation))
