"""Units and labels as the makers of capture systems write them."""

from pathlib import Path

from headcap.errors import InputError

_METRES = {
    "m": 1.0,
    "meter": 1.0,
    "meters": 1.0,
    "metre": 1.0,
    "metres": 1.0,
    "dm": 0.1,
    "cm": 0.01,
    "mm": 0.001,
    "millimeters": 0.001,
}


def metres_per(unit: str | None, path: Path) -> float:
    """Metres of a unit's name; raises `InputError` where it is unknown or not said."""
    name = (unit or "").strip().lower()
    if name not in _METRES:
        raise InputError(
            f"{path.name} {f'is in {unit!r}' if name else 'does not say its unit'}",
            expected="m, cm or mm",
            remedy="Name the unit of its numbers.",
        )
    return _METRES[name]


def plain_labels(labels: list[str]) -> list[str]:
    """Labels without the subject's name before a colon, where they stay different without it."""
    plain = [label.rsplit(":", 1)[-1].strip() for label in labels]
    return plain if len(set(plain)) == len(set(labels)) else [label.strip() for label in labels]
