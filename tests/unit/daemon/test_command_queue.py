"""The order of service when more commands arrive than a tick serves."""

from hypothesis import given
from hypothesis import strategies as st

from palmd.daemon.command_queue import MAX_OWNER_EXTRA, MAX_WAITING, PER_TICK, CommandQueue
from palmd.daemon.commands import COMMANDS, Request
from palmd.daemon.ownership import ALWAYS_OBEYED, client_of


def asked(name, client, number=0):
    return Request(name, id=number, client=client)


OWNER = client_of(asked("arm", "owner")).key


def filled(*requests):
    queue = CommandQueue()
    refused = [queue.add(request, OWNER) for request in requests]
    return queue, [each for each in refused if each is not None]


def crowd(count, name="status"):
    return [asked(name, f"c{number}", number) for number in range(count)]


def test_a_few_commands_are_served_in_order_of_arrival():
    requests = [asked("arm", "a"), asked("stop", "b"), asked("status", "c"), asked("start", "a")]
    queue, _ = filled(*requests)
    assert queue.take(OWNER) == (requests, [])
    assert queue.take(OWNER) == ([], [])


def test_stop_and_hold_precede_the_owners_then_other_commands_then_queries():
    stop, hold, own, arm = asked("stop", "x"), asked("hold", "y"), asked("jog", "owner"), asked("note", "z")
    queue, _ = filled(*crowd(20), own, stop, arm, hold)
    queue.add(own, OWNER)
    served, refused = queue.take(OWNER)
    assert served[:2] == [stop, hold]
    assert arm in served[2:]
    assert refused == [(own, "a hold has overtaken it")]
    assert len(served) == 2 + PER_TICK


def test_the_owners_command_is_queued_even_if_the_queue_is_full():
    queue, _ = filled(*crowd(MAX_WAITING))
    own = [asked("jog", "owner", number) for number in range(MAX_OWNER_EXTRA + 1)]
    refused = [queue.add(each, OWNER) for each in own]
    assert not any(refused[:-1])
    assert queue.take(OWNER)[0] == own[:PER_TICK]


def test_a_command_displaces_a_query_and_a_client_with_few_requests_one_with_many():
    greedy = [asked("status", "greedy", number) for number in range(MAX_WAITING)]
    for newcomer in (asked("arm", "new"), asked("status", "modest")):
        queue, _ = filled(*greedy)
        assert queue.add(asked("status", "greedy", 99), OWNER)[0].id == 99
        victim, why = queue.add(newcomer, OWNER)
        assert victim.client == "greedy"
        assert "busy" in why
        assert newcomer in queue.take(OWNER)[0]


def test_moving_commands_overtaken_by_a_stop_are_refused():
    before = [asked("start", f"c{number}") for number in range(8)]
    after = asked("start", "late")
    queue, _ = filled(*before, asked("stop", "x"), after)
    served, refused = queue.take(OWNER)
    assert [each.name for each in served] == ["stop", "start"]
    assert served[1] is after
    assert [each for each, _ in refused] == before


REQUESTS = st.lists(
    st.tuples(st.sampled_from(sorted(COMMANDS)), st.sampled_from(["owner", "a", "b", "c"]), st.booleans()), max_size=150
)


@given(REQUESTS)
def test_each_request_leaves_once_and_stop_and_hold_are_always_served(story):
    queue, out, came = CommandQueue(), [], []
    for number, (name, client, tick) in enumerate(story):
        request = asked(name, client, number)
        came.append(request)
        refused = queue.add(request, OWNER)
        if refused is not None:
            out.append(refused[0].id)
            assert refused[0].name not in ALWAYS_OBEYED or "is already waiting" in refused[1]
        if tick:
            waited = any(each.name in ALWAYS_OBEYED for each, _ in queue._waiting)
            served, late = queue.take(OWNER)
            assert len([each for each in served if each.name not in ALWAYS_OBEYED]) <= PER_TICK
            assert waited == any(each.name in ALWAYS_OBEYED for each in served)
            out += [each.id for each in served] + [each.id for each, _ in late]
        assert len(queue) <= MAX_WAITING + MAX_OWNER_EXTRA + len(ALWAYS_OBEYED)
    while len(queue):
        served, late = queue.take(OWNER)
        out += [each.id for each in served] + [each.id for each, _ in late]
    assert sorted(out) == [each.id for each in came]
