"""How an SVG shows its parts, by its style sheets and by their own attributes and styles; for `_svg`.

Programs hide layers by rules for classes, and draw frames without fill and stroke round what is to be seen.
"""

import re
from collections.abc import Mapping
from xml.etree.ElementTree import Element

# What moves a part, which is read from the attribute `transform` alone.
TRANSFORMS = ("transform", "rotate", "translate", "scale")
# How a part may be shown, by attributes, styles and rules, and the values that do nothing.
_SHOWN = {
    "display": ("inline", "block"),
    "visibility": ("visible",),
    **dict.fromkeys((*TRANSFORMS, "clip-path", "mask"), ("none",)),
}
# What makes a shape, which is read from its attributes alone.
GEOMETRY = ("d", "r", "cx", "cy", "rx", "ry", "x", "y", "width", "height")
# What is said of paint, and of the point that a transform leaves where it is.
_PAINT = ("fill", "fill-opacity", "stroke", "stroke-opacity", "stroke-width", "opacity")
_SAID = (*_SHOWN, *_PAINT, *GEOMETRY, "transform-origin")
_INHERITED = ("visibility", *_PAINT[:-1])
_SIMPLE = re.compile(r"[.#]?[\w-]+|\*")
# What the outermost part inherits.
OUTERMOST = {"visibility": "visible", "fill": "black", "stroke": "none"}


def kind_of(part: Element) -> str:
    """The name of a part of an SVG; empty for parts of other kinds of files, and for remarks."""
    name = part.tag if isinstance(part.tag, str) else ""
    name = name.removeprefix("{http://www.w3.org/2000/svg}")
    return "" if "}" in name else name


def inherited(said: Mapping[str, str]) -> dict[str, str]:
    """What the parts of a part take over from it, where they do not say otherwise."""
    return {name: said[name] for name in _INHERITED if name in said}


class StyleSheet:
    """The style rules of a drawing for all parts ("*"), a kind ("path"), a class (".a") or a name ("#a").

    Others may be there if they say nothing of how parts are shown.
    """

    def __init__(self, root: Element) -> None:
        text = " ".join(part.text or "" for part in root.iter() if kind_of(part) == "style")
        text = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
        self._rules: dict[str, list[tuple[int, dict[str, str]]]] = {}
        # Where a rule for other parts paints, what is without paint is not known.
        self._paints = True
        for place, (names, block) in enumerate(re.findall(r"([^{};]*){([^{}]*)}", text)):
            self._add(place, names, {name: value for name, value in _rules(block).items() if name in _SAID})

    def _add(self, place: int, names: str, rules: dict[str, str]) -> None:
        changing = any(value not in _SHOWN[name] for name, value in rules.items() if name in _SHOWN)
        for name in map(str.strip, names.split(",")):
            if _SIMPLE.fullmatch(name):
                self._rules.setdefault(name, []).append((place, rules))
                continue
            if changing:
                raise ValueError(f"its style rule for {name} is not for one class, name or kind of shape")
            self._paints = self._paints and not any(rule in _PAINT for rule in rules)

    def said(self, part: Element, around: Mapping[str, str]) -> dict[str, str]:
        """How a part is shown, by its style, else by rules, else by attributes, else by what it inherits."""
        found = {**around, **{name: _word(part.attrib[name]) for name in _SAID if name in part.attrib}}
        classes = dict.fromkeys(f".{name}" for name in part.get("class", "").split())
        for level in (("*",), (kind_of(part),), classes, (f"#{part.get('id')}",)):
            several = [rule for name in level for rule in self._rules.get(name, ())]
            # Of rules for several classes of a part the one counts that comes last in the sheet.
            for _, rules in sorted(several, key=lambda rule: rule[0]):
                found |= rules
        found |= {name: value for name, value in _rules(part.get("style", "")).items() if name in _SAID}
        return {**found, **{name: around[name] for name in around if found[name] == "inherit"}}

    def painted(self, said: Mapping[str, str]) -> bool:
        """Whether a shape has a fill or a stroke, so far as the sheet tells."""
        width = {"fill": "1", "stroke": said.get("stroke-width", "1")}
        return not self._paints or any(
            said[name] != "none"
            and not _is_clear(said[name])
            and not any(map(is_zero, (width[name], said.get(f"{name}-opacity", "1"))))
            for name in width
        )


def _rules(text: str) -> dict[str, str]:
    """The rules of a style by name, `display: none; ...`."""
    pairs = (rule.split(":", 1) for rule in text.split(";") if ":" in rule)
    return {name.strip().lower(): _word(value.replace("!important", "").strip()) for name, value in pairs}


def _word(value: str) -> str:
    """A value in small letters if it is one word, whose case does not matter."""
    return value.lower() if re.fullmatch(r"\s*[A-Za-z]+\s*", value) else value


def _is_clear(colour: str) -> bool:
    """Whether nothing is seen of a colour: by its word, its last digits or the last of its four numbers."""
    inside = re.fullmatch(r"\s*\w+\(([^()]*)\)\s*", colour)
    numbers = re.split(r"[\s,/]+", inside[1].strip()) if inside else []
    digits = re.fullmatch(r"\s*#([0-9a-fA-F]{3}0|[0-9a-fA-F]{6}00)\s*", colour)
    return colour == "transparent" or digits is not None or (len(numbers) == 4 and is_zero(numbers[3]))


def is_zero(text: str) -> bool:
    """Whether a number, perhaps with a unit, is zero."""
    return re.fullmatch(r"\s*[+-]?0*\.?0*(px|%)?\s*", text) is not None and "0" in text
