"""Unroll the jumps of a mission, which repeat a part of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from simulate.flight.commands import Command, Mav

_MAX_COMMANDS = 100_000  # largest number of executed commands


def unroll(commands: Sequence[Command]) -> list[Command]:
    """Return the commands in order of execution, without jumps.

    A jump is executed as often as its repeat count over the whole mission, and then skipped.

    Raises:
        InputError: A jump has no unique target, does not end, or makes the mission too long.
    """
    if not any(c.command in (Mav.JUMP, Mav.JUMP_TO_TAG) for c in commands):
        return [c for c in commands if c.command != Mav.JUMP_TAG]
    executed: list[Command] = []
    jumped: Counter[int] = Counter()
    row = 0
    while row < len(commands):
        command = commands[row]
        if command.command not in (Mav.JUMP, Mav.JUMP_TO_TAG):
            if command.command != Mav.JUMP_TAG:
                executed.append(command)
            row += 1
            continue
        repeats, target = _repeats(command), _target(commands, command)
        if jumped[row] >= repeats:
            row += 1
            continue
        jumped[row] += 1
        if len(executed) + sum(jumped.values()) > _MAX_COMMANDS:
            raise command.error(
                f"makes the mission longer than {_MAX_COMMANDS} commands", "repeat less often"
            )
        row = target
    return executed


def _repeats(command: Command) -> int:
    repeats = command.number(1, "repeat count")
    if repeats < 0:
        raise command.error("repeats without an end", "set its repeat count")
    if repeats != int(repeats):
        raise command.error(f"repeats {repeats:g} times (params[1])", "set a whole number")
    return int(repeats)


def _target(commands: Sequence[Command], jump: Command) -> int:
    """Return the row of a jump's target."""
    target_number = jump.number(0, "target")
    if jump.command == Mav.JUMP_TO_TAG:
        tags = (c.params[0] if c.command == Mav.JUMP_TAG else None for c in commands)
        rows = [row for row, tag in enumerate(tags) if tag == target_number]
    else:
        rows = [row for row, c in enumerate(commands) if c.jump_id == target_number]
    if len(rows) != 1:
        raise jump.error(
            f"jumps to {target_number:g}, but {len(rows) or 'no'} commands have that number",
            "save the plan in QGroundControl again",
        )
    return rows[0]
