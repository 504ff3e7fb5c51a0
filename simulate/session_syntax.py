"""Read a session (one flight under one condition) as it is written on the command line."""

from __future__ import annotations

from typing import Literal, get_args

from simulate.flight.config import PATH_FIELDS
from simulate.place.change import Change

Role = Literal["map", "query"]


def parse_session(text: str, first: bool) -> dict[str, object]:
    """Return the values of a session that is written ``condition:flight[:role][:change]``.

    Args:
        text: the session as text.
        first: whether the session is the first of a scene, whose default role is "map".

    Raises:
        ValueError: the text does not describe a session.
    """
    name, colon, flight = text.partition(":")
    if not colon:
        raise ValueError(f"a session is written condition:flight[:role][:change], got {text!r}")
    session: dict[str, object] = {"condition": name, "role": "map" if first else "query"}
    # A path may contain colons.
    has_path = flight.partition("=")[0] in PATH_FIELDS
    head, _, last = flight.rpartition(":")
    if head and (last.partition("=")[0] in Change.model_fields if has_path else "=" in last):
        session["change"] = dict(_parse_setting(word) for word in last.split(","))
        flight = head
    head, _, last = flight.rpartition(":")
    if head and (last in get_args(Role) or not has_path):
        session["role"] = last
        flight = head
    return session | {"flight": flight}


def _parse_setting(word: str) -> tuple[str, str]:
    key, equals, value = word.partition("=")
    if not equals:
        raise ValueError(
            f"a change is written NAME=VALUE[,NAME=VALUE...], such as cars_moved=0.3; got {word!r}"
        )
    return key, value
