"""Who is let in, and whom for whom."""

import asyncio
import errno
import socket
from pathlib import Path

import pytest

from gsynopsis.serve import gate as gate_module
from gsynopsis.serve.gate import ACCEPTS, Gate, Limits, Listener, descriptors, network_of


class Loop:
    """Counts what is to be done later."""

    def __init__(self) -> None:
        self.later: list[object] = []

    def call_later(self, seconds: float, *call: object) -> None:
        self.later.append(call)


class Caller:
    """A connection that leaves when it is dropped."""

    def __init__(self, gate: Gate, host: str = "a") -> None:
        self.gate, self.host, self.dropped = gate, host, False
        assert gate.admit(host)
        gate.enter(self, LOOP)  # type: ignore[arg-type]
        gate.wait(self)

    def drop(self) -> None:
        self.dropped = True
        self.gate.leave(self)

    def check(self, now: float) -> None:
        pass


LOOP = Loop()


def test_the_longest_waiting_leaves_first_and_who_is_answered_stays() -> None:
    gate = Gate(Limits(connections=3, share=1.0, spared_seconds=0))
    first, second, third = (Caller(gate) for _ in range(3))
    gate.serve(first)
    gate.wait(third)
    fourth = Caller(gate)
    assert [c.dropped for c in (first, second, third, fourth)] == [False, True, False, False]
    for caller in (third, fourth):
        gate.serve(caller)
    assert not gate.admit("a") and gate.count == 3
    gate.wait(first)
    assert Caller(gate).gate.count == 3 and first.dropped


def test_an_address_makes_room_for_itself_only_at_its_own_cost() -> None:
    gate = Gate(Limits(connections=10, share=0.3, spared_seconds=0))
    other = Caller(gate, "b")
    own = [Caller(gate, "a") for _ in range(5)]
    assert [caller.dropped for caller in own] == [True, True, False, False, False]
    assert not other.dropped and gate.count == 4


def test_who_has_just_begun_to_wait_is_not_let_go_for_another_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [100.0]
    monkeypatch.setattr(gate_module, "monotonic", lambda: now[0])
    gate = Gate(Limits(connections=1, share=1.0, spared_seconds=0.25))
    first = Caller(gate)
    now[0] += 0.2
    assert not gate.admit("b") and not first.dropped
    now[0] += 0.1
    assert gate.admit("b") and first.dropped


def test_who_takes_nothing_or_is_done_goes_first_and_at_once() -> None:
    gate = Gate(Limits(connections=3, share=1.0, spared_seconds=1000))
    first, second, third = (Caller(gate) for _ in range(3))
    assert not gate.admit("a")
    for caller in (third, second):
        gate.yields(caller)
    gate.serve(third)  # it takes something again
    assert Caller(gate).gate.count == 3
    assert [c.dropped for c in (first, second, third)] == [False, True, False]
    assert not gate.admit("a")
    gate.yields(first)
    gate.close()
    assert first.dropped and not third.dropped


def test_a_request_that_is_here_goes_before_one_that_may_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [100.0]
    monkeypatch.setattr(gate_module, "monotonic", lambda: now[0])
    gate = Gate(Limits(connections=2, share=1.0, spared_seconds=0.25, hurried_seconds=0.05))
    answered, silent = Caller(gate), Caller(gate)
    gate.serve(answered)
    gate.wait(answered)
    now[0] += 0.04
    assert not gate.admit("a", ready=True)
    now[0] += 0.02
    assert not gate.admit("a", ready=False)
    assert gate.admit("a", ready=True) and silent.dropped
    assert not gate.admit("a", ready=True) and not answered.dropped


def test_what_left_is_not_counted_any_more() -> None:
    gate = Gate(Limits(connections=2, share=1.0))
    for _ in range(10):
        callers = [Caller(gate, "a"), Caller(gate, "b")]
        for caller in callers:
            gate.leave(caller)
    assert gate.count == 0 and gate.admit("a")


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("10.0.0.1", "10.0.0.1", True),
        ("10.0.0.1", "10.0.0.2", False),
        ("2001:db8::1", "2001:db8::ffff:2", True),
        ("2001:db8:0:1::1", "2001:db8:0:2::1", False),
        ("::ffff:10.0.0.1", "10.0.0.1", True),
        ("fe80::1%eth0", "fe80::2%eth1", True),
        ("no address", "no address", True),
    ],
)
def test_an_address_is_what_one_customer_has(one: str, other: str, same: bool) -> None:
    assert (network_of(one) == network_of(other)) == same


@pytest.mark.parametrize(
    ("soft", "hard", "reached", "connections"),
    [(1024, 1 << 20, 8272, 4096), (256, 256, 256, 88), (64, 64, 64, 1), (20000, 20000, 8272, 4096)],
)
def test_connections_fit_into_the_descriptors_of_the_process(
    soft: int, hard: int, reached: int, connections: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    resource = pytest.importorskip("resource")
    state = [soft, hard]
    monkeypatch.setattr(resource, "getrlimit", lambda _: tuple(state))
    monkeypatch.setattr(resource, "setrlimit", lambda _, wanted: state.__setitem__(0, wanted[0]))
    assert descriptors(8272) == reached
    limits = Limits().fitted()
    assert limits.connections == connections
    assert limits.per_address == max(1, connections // 2)


def listening(limits: Limits) -> Listener:
    listener = Listener(socket.create_server(("127.0.0.1", 0)), Gate(limits))
    listener.setblocking(False)
    return listener


def test_who_is_turned_away_is_told_so() -> None:
    with listening(Limits(connections=1)) as listener:
        address = listener.getsockname()
        with socket.create_connection(address), socket.create_connection(address, 5) as second:
            listener.accept()[0].close()
            with pytest.raises(BlockingIOError):
                listener.accept()
            assert second.recv(100).startswith(b"HTTP/1.1 503 ")


BODY = b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 9\r\n\r\n"


@pytest.mark.parametrize("places", [2, 1])
def test_a_body_is_refused_at_the_door_and_nobody_goes_for_that(places: int) -> None:
    async def knock(listener: Listener) -> list[int]:
        gate = listener.gate
        resting = Caller(gate, "127.0.0.1")
        with socket.create_connection(listener.getsockname(), 5) as client:
            client.sendall(BODY)
            with pytest.raises(BlockingIOError):
                listener.accept()
            counts = [gate.count]
            assert client.recv(1000).startswith(b"HTTP/1.1 405 ")
            await asyncio.sleep(0.05)
            assert not resting.dropped
        listener.close()
        return [*counts, gate.count]

    limits = Limits(connections=places, share=1.0, spared_seconds=0)
    with listening(limits) as listener:
        assert asyncio.run(knock(listener)) == [places, 1]


def test_no_more_come_in_than_enter() -> None:
    with listening(Limits()) as listener:
        address = listener.getsockname()
        callers = [socket.create_connection(address) for _ in range(ACCEPTS + 1)]
        taken = [listener.accept()[0] for _ in range(ACCEPTS)]
        with pytest.raises(BlockingIOError):
            listener.accept()
        for connection in [*callers, *taken]:
            connection.close()


def test_without_descriptors_it_rests_and_makes_room(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[float] = []

    def accept(self: socket.socket) -> tuple[socket.socket, object]:
        calls.append(0)
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(socket.socket, "accept", accept)
    now = [100.0]
    monkeypatch.setattr(gate_module, "monotonic", lambda: now[0])
    with listening(Limits()) as listener:
        caller = Caller(listener.gate)
        now[0] += 1
        with pytest.raises(OSError, match="Too many"):
            listener.accept()
        for _ in range(2048):  # as asyncio does in a row
            with pytest.raises(BlockingIOError):
                listener.accept()
        assert len(calls) == 1 and caller.dropped
        now[0] += gate_module.PAUSE_SECONDS
        with pytest.raises(OSError, match="Too many"):
            listener.accept()


def test_the_system_keeps_many_that_wait_to_be_accepted(tmp_path: Path) -> None:
    with listening(Limits()) as listener:
        listener.listen(ACCEPTS)
        callers = [socket.create_connection(listener.getsockname(), 2) for _ in range(200)]
        for connection in callers:
            connection.close()
    assert len(callers) == 200
