"""A camera's triggers, command by command."""

from simulate.flight.commands import Command, Mav
from simulate.flight.trigger import Triggers


def start_by_distance(metres: float, *, at_once: bool) -> Command:
    params = [metres, 0, int(at_once), 0, 0, 0, 0]
    return Command.model_validate({"command": int(Mav.TRIGGER_DISTANCE), "params": params})


def test_a_distance_trigger_restarted_at_its_last_photograph_takes_no_second_one() -> None:
    triggers = Triggers()
    assert triggers.execute(start_by_distance(10, at_once=True))
    assert not triggers.execute(start_by_distance(20, at_once=True))
    triggers.advance(5, 1)
    assert triggers.execute(start_by_distance(10, at_once=True))
    assert not triggers.execute(start_by_distance(10, at_once=True))


def test_a_trigger_that_took_no_photograph_at_once_takes_the_first_when_restarted() -> None:
    triggers = Triggers()
    assert not triggers.execute(start_by_distance(10, at_once=False))
    assert triggers.execute(start_by_distance(10, at_once=True))
