"""Runs a simulation in real time and lets other programs on its bus."""

import selectors
import socket
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from mdms_sim.serve import packet
from mdms_sim.serve.client import Client, GoneError, PacketCodec, SlcanCodec
from mdms_sim.serve.clock import RealTime
from mdms_sim.serve.endpoint import LOOPBACK, Terminal, accept, listen_tcp, listen_unix
from mdms_sim.simulation import Simulation

#: The simulation is not run further than this without looking after the clients.
SLICE_NS = 1_000_000

Report = Callable[[str], object]


@dataclass(frozen=True, slots=True)
class Addresses:
    """What a client has to name: python-can's channel, a serial device, a TCP port."""

    channel: str
    device: str
    tcp_port: int


class Server:
    """A running array with its addresses open; close it when done.

    `report(text)` gets a line for each client that comes or goes. Raises `ServeError`.
    """

    def __init__(
        self,
        simulation: Simulation,
        channel: str,
        tcp_port: int = 0,
        speed: float = 1.0,
        report: Report = lambda _text: None,
    ) -> None:
        self._simulation = simulation
        self._report = report
        self._selector = selectors.DefaultSelector()
        self._clients: dict[int, Client] = {}
        self._ready: dict[int, Callable[[int], None]] = {}
        self._connections: dict[int, socket.socket] = {}
        self._leaving: list[Client] = []
        # Whatever is compiled at its first use is so before anybody can come in and time counts.
        simulation.kernel.run_until(SLICE_NS)
        self._channel = channel
        self._unix = listen_unix(channel)
        self._tcp = listen_tcp(tcp_port)
        self._terminal = Terminal()
        self.addresses = Addresses(channel, self._terminal.name, self._tcp.getsockname()[1])
        self._listen(self._unix, "python-can")
        self._listen(self._tcp, "SLCAN over TCP")
        self._admit("SLCAN terminal", self._terminal.descriptor, slcan=True)
        simulation.bus.observe_errors(self._on_error)
        self.time = RealTime(speed)

    def __enter__(self) -> "Server":
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    @property
    def clients(self) -> tuple[Client, ...]:
        """Who is on the bus, the terminal's line among them."""
        return tuple(self._clients.values())

    def run(self, over: Callable[[], bool] = lambda: False) -> None:
        """Serve until it is over, which is asked about a thousand times a second."""
        while not over() and not self._simulation.tipped:
            self._simulate()
            self._serve_clients()

    def close(self) -> None:
        """Shut all addresses and take the clients off the bus."""
        for descriptor in list(self._clients):
            self._dismiss(descriptor, "the array is switched off")
        for client in self._leaving:
            client.leave()
        for listener in (self._unix, self._tcp):
            listener.close()
        packet.socket_path(self._channel).unlink(missing_ok=True)
        self._terminal.close()
        self._selector.close()

    def _simulate(self) -> None:
        kernel = self._simulation.kernel
        due_ns = self.time.sim_ns(kernel.now_ns)
        if due_ns > kernel.now_ns:
            kernel.run_until(min(due_ns, kernel.now_ns + SLICE_NS))

    def _serve_clients(self) -> None:
        kernel = self._simulation.kernel
        for descriptor, client in list(self._clients.items()):
            if client.wants_to_write:
                client.write()
            self._watch(descriptor, client)
        # No time passes in the simulation while what a client has sent is on its way.
        self._terminal.settle()
        next_ns = kernel.next_ns
        wait_s = 0.0 if next_ns is None else self.time.wait_s(next_ns, kernel.now_ns)
        for key, events in self._selector.select(wait_s):
            key.data(events)

        self._see_off()

    def _see_off(self) -> None:
        """Take those off the bus whose last frames it has carried."""
        staying = [client for client in self._leaving if client.has_frames_to_send]
        for client in self._leaving:
            if client not in staying:
                client.leave()
        self._leaving = staying

    def _listen(self, listener: socket.socket, kind: str) -> None:
        def welcome(_events: int) -> None:
            accept(listener, partial(self._connect, kind))

        self._selector.register(listener, selectors.EVENT_READ, welcome)

    def _connect(self, kind: str, connection: socket.socket) -> None:
        self._connections[connection.fileno()] = connection
        self._admit(kind, connection.fileno(), slcan=kind != "python-can")
        self._report(f"a client has come: {kind}")

    def _admit(self, kind: str, descriptor: int, slcan: bool) -> None:
        codec = SlcanCodec if slcan else partial(PacketCodec, epoch_s=self._epoch_s)
        client = Client(kind, descriptor, self._simulation.bus, codec)

        def ready(events: int) -> None:
            if events & selectors.EVENT_WRITE:
                client.write()
            if events & selectors.EVENT_READ:
                self._read(descriptor, client)

        self._clients[descriptor] = client
        self._ready[descriptor] = ready
        self._selector.register(descriptor, selectors.EVENT_READ, ready)

    def _watch(self, descriptor: int, client: Client) -> None:
        """Listen only for what can be served: a bus that is full does not read on."""
        if descriptor not in self._clients:
            return
        wanted = selectors.EVENT_READ if client.may_send else 0
        wanted |= selectors.EVENT_WRITE if client.wants_to_write else 0
        key = self._selector.get_map().get(descriptor)
        if wanted and key is None:
            self._selector.register(descriptor, wanted, self._ready[descriptor])
        elif wanted and key is not None and key.events != wanted:
            self._selector.modify(descriptor, wanted, key.data)
        elif not wanted and key is not None:
            self._selector.unregister(descriptor)

    def _read(self, descriptor: int, client: Client) -> None:
        try:
            client.read()
        except GoneError as error:
            self._dismiss(descriptor, str(error))

    def _dismiss(self, descriptor: int, reason: str) -> None:
        client = self._clients.pop(descriptor)
        del self._ready[descriptor]
        client.hear_no_more()
        self._leaving.append(client)
        if descriptor in self._selector.get_map():
            self._selector.unregister(descriptor)
        connection = self._connections.pop(descriptor, None)
        if connection is not None:
            connection.close()
            lost = f"; {client.dropped} frames dropped" if client.dropped else ""
            bad = f"; {client.garbage} times garbage" if client.garbage else ""
            self._report(f"a client has left: {client.name}: {reason}{lost}{bad}")

    def _on_error(self, now_ns: int) -> None:
        for client in self._clients.values():
            client.on_error(now_ns)

    def _epoch_s(self, sim_ns: int) -> float:
        return self.time.epoch_s(sim_ns)


def ways_in(addresses: Addresses) -> tuple[str, ...]:
    """Lines to copy and paste, one a way in."""
    return (
        f"mdms scan -i mdms -c {addresses.channel}",
        f"python -m can.viewer -i mdms -c {addresses.channel}",
        f"mdms scan -i slcan -c {addresses.device} -b 1000000",
        f"mdms scan -i slcan -c socket://{LOOPBACK}:{addresses.tcp_port} -b 1000000",
    )
