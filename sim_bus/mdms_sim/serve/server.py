"""Runs a simulation in real time and lets other programs on its bus."""

import select
import selectors
import socket
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Self

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.controller import Controller, ErrorState
from mdms_sim.serve.client import (
    BusClient,
    Codec,
    GoneError,
    PacketCodec,
    Packets,
    StrictAdapter,
)
from mdms_sim.serve.clock import Lateness, RealTime
from mdms_sim.serve.endpoint import (
    LOOPBACK,
    Acceptor,
    FullError,
    Terminal,
    UnixListener,
    listen_tcp,
    refuse_elsewhere,
)
from mdms_sim.serve.slcan import VirtualAdapter
from mdms_sim.simulation import Simulation

#: The simulation is not run further than this without looking after the clients.
SLICE_NS = 1_000_000
#: How often somebody looks whether cells blink.
LOOK_NS = 50_000_000
#: Every connection costs time at each frame; more are refused.
CONNECTIONS_MAX = 16
#: Linux tells the end of a client whose last bytes are unread; elsewhere hanging up is told anyway.
_HANGS_UP = getattr(select, "POLLRDHUP", 0)

Report = Callable[[str], object]
MakeCodec = Callable[[Callable[..., bool]], Codec]


@dataclass(frozen=True, slots=True)
class ServedAddresses:
    """The name for a client: python-can's channel, a serial device, a TCP port if open.

    `bitrate` is that of the bus [bit/s].
    """

    channel: str
    device: str
    tcp_port: int | None
    bitrate: int


class Server:
    """A running array with the addresses of its buses open; close it when done.

    Of several buses each has the channel's name with its number, from 0: `array54.0` and so on.
    `addresses` are those of the first bus, `all_addresses` of all. SLCAN over TCP is open with a
    `tcp_port` only, for the first bus, and on the ports after it for the others; 0 takes free ones.
    `report(text)` gets a line for each client that comes or goes, and each cell that begins to
    blink. Raises `ServeError`.
    """

    def __init__(
        self,
        simulation: Simulation,
        channel: str,
        tcp_port: int | None = None,
        speed: float = 1.0,
        report: Report = lambda _text: None,
    ) -> None:
        refuse_elsewhere()
        self.simulation = simulation
        self._report = report
        self._clients: dict[int, BusClient] = {}
        self._ready: dict[int, Callable[[int], None]] = {}
        self._connections: dict[int, socket.socket] = {}
        self._leaving: list[BusClient] = []
        self._refusing = False
        self._blinking: list[int] = []
        self._look_ns = 0
        # All code is compiled before anybody can come in and time counts.
        simulation.kernel.run_until(SLICE_NS)
        self.time = RealTime(speed)
        self._lateness = Lateness(self.time, report)
        with ExitStack() as opened:
            self._open(opened, channel, tcp_port)
            self._opened = opened.pop_all()
        for bus in simulation.buses:
            bus.observe_errors(partial(self._on_error, bus))
            bus.observe_states(self._on_state)

    def _open(self, opened: ExitStack, channel: str, tcp_port: int | None) -> None:
        """Open everything that is to be closed at the end."""
        self._selector = opened.enter_context(selectors.DefaultSelector())
        self._acceptor = Acceptor()
        opened.callback(self._acceptor.close)
        self._terminals: list[Terminal] = []
        buses = self.simulation.buses
        self.all_addresses = tuple(
            self._open_bus(
                opened,
                bus,
                channel if len(buses) == 1 else f"{channel}.{number}",
                tcp_port + number if tcp_port else tcp_port,
            )
            for number, bus in enumerate(buses)
        )
        self.addresses = self.all_addresses[0]

    def _open_bus(
        self, opened: ExitStack, bus: Bus, channel: str, tcp_port: int | None
    ) -> ServedAddresses:
        """Open the doors of one bus."""
        terminal = Terminal()
        opened.callback(terminal.close)
        self._terminals.append(terminal)
        make_adapter: MakeCodec = partial(self._codec_now, bitrate=bus.bitrate)
        self._admit("SLCAN terminal", bus, terminal.descriptor, make_adapter, terminal.forget)
        if tcp_port is not None:
            tcp = opened.enter_context(listen_tcp(tcp_port))
            tcp_port = tcp.getsockname()[1]
            self._listen(tcp, "SLCAN over TCP", bus, partial(StrictAdapter, bitrate=bus.bitrate))
        unix = UnixListener(channel)
        opened.callback(unix.close)
        packets = Packets(self.time.epoch_s)
        make_codec = partial(PacketCodec, packets=packets, bitrate=bus.bitrate)
        self._listen(unix.socket, "python-can", bus, make_codec)
        return ServedAddresses(channel, terminal.name, tcp_port, bus.bitrate)

    def _codec_now(self, send: Callable[[Frame], bool], bitrate: int) -> Codec:
        """Refuse lines with frames while time stands still: nobody sees a terminal's client go."""
        return VirtualAdapter(lambda frame: self.time.speed > 0 and send(frame), bitrate)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    def run(self, over: Callable[[], object] = lambda: False) -> None:
        """Serve until it is over, which is asked about a thousand times a second.

        A parcel that tips ends it, unless the simulation goes on beyond that.
        """
        while not over() and not self.simulation.tipped:
            self._simulate()
            self._serve_clients()
            self._look_at_lights()
            self._lateness.look(self.simulation.kernel.now_ns)

    def close(self) -> None:
        """Shut all addresses and take the clients off the bus."""
        for descriptor in list(self._clients):
            self._dismiss(descriptor, "the array is switched off")
        for client in self._leaving:
            client.leave()
        self._opened.close()

    def _simulate(self) -> None:
        kernel = self.simulation.kernel
        due_ns = self.time.sim_ns(kernel.now_ns)
        if due_ns > kernel.now_ns:
            kernel.run_until(min(due_ns, kernel.now_ns + SLICE_NS))

    def _look_at_lights(self) -> None:
        """Report which cells begin to blink, at the places where a person would see it."""
        if self.simulation.kernel.now_ns < self._look_ns:
            return
        self._look_ns = self.simulation.kernel.now_ns + LOOK_NS
        blinking = self.simulation.blinking
        for place in sorted({*blinking} - {*self._blinking}):
            self._report(f"the cell at place {place} blinks")
        self._blinking = blinking

    def _serve_clients(self) -> None:
        kernel = self.simulation.kernel
        if not self.time.speed:
            self._dismiss_hung_up()
        for descriptor, client in list(self._clients.items()):
            if client.wants_to_write:
                client.write()
            self._watch(descriptor, client)
        # No time passes in the simulation while a client's bytes are on their way.
        for terminal in self._terminals:
            self.time.settle(terminal.settle)
        next_ns = kernel.next_ns
        wait_s = 0.0 if next_ns is None else self.time.wait_s(next_ns, kernel.now_ns)
        for key, events in self._selector.select(wait_s):
            key.data(events)
        self._see_off()

    def _dismiss_hung_up(self) -> None:
        """Dismiss clients that have gone, with bytes that they have sent and nobody has read."""
        poll = select.poll()
        for descriptor in self._connections:
            poll.register(descriptor, _HANGS_UP)
        for descriptor, _ in poll.poll(0):
            self._dismiss(descriptor, "it has closed its end while time stands still")

    def _see_off(self) -> None:
        """Take those off the bus whose last frames it has carried, or while time stands still."""
        staying = [each for each in self._leaving if each.has_frames_to_send and self.time.speed]
        for client in self._leaving:
            if client not in staying:
                client.leave()
        self._leaving = staying

    def _listen(self, listener: socket.socket, kind: str, bus: Bus, make_codec: MakeCodec) -> None:
        def welcome(_events: int) -> None:
            try:
                connection = self._accept(listener)
            except FullError as error:
                self._on_refused(str(error))
            else:
                if connection is not None:
                    self._connect(kind, bus, connection, make_codec)

        self._selector.register(listener, selectors.EVENT_READ, welcome)

    def _accept(self, listener: socket.socket) -> socket.socket | None:
        """The next connection, if any. Raises FullError for a client that was refused."""
        connection = self._acceptor.accept(listener)
        # A client that has left with frames still to be sent is on the bus as well.
        if connection and len(self._connections) + len(self._leaving) >= CONNECTIONS_MAX:
            connection.close()
            raise FullError(f"{CONNECTIONS_MAX} are open, which is the most")
        return connection

    def _on_refused(self, reason: str) -> None:
        """Of many refused in a row the first is reported."""
        if not self._refusing:
            self._report(f"connections are refused: {reason}")
        self._refusing = True

    def _connect(
        self, kind: str, bus: Bus, connection: socket.socket, make_codec: MakeCodec
    ) -> None:
        self._refusing = False
        self._connections[connection.fileno()] = connection
        self._admit(kind, bus, connection.fileno(), make_codec)
        self._report(f"a client has come: {kind}")

    def _admit(
        self,
        kind: str,
        bus: Bus,
        descriptor: int,
        make_codec: MakeCodec,
        forget: Callable[[], object] = lambda: None,
    ) -> None:
        client = BusClient(kind, descriptor, bus, make_codec, forget)

        def ready(events: int) -> None:
            if events & selectors.EVENT_WRITE:
                client.write()
            if events & selectors.EVENT_READ:
                self._read(descriptor, client)

        self._clients[descriptor] = client
        self._ready[descriptor] = ready
        self._selector.register(descriptor, selectors.EVENT_READ, ready)

    def _watch(self, descriptor: int, client: BusClient) -> None:
        """Listen only for as many clients as can be served: a bus that is full does not read on."""
        if descriptor not in self._clients:
            return
        may_read = client.may_read(self.simulation.kernel.now_ns)
        # Frames of a terminal's client are refused then, so none is left for later.
        may_read |= not self.time.speed and descriptor not in self._connections
        wanted = selectors.EVENT_READ if may_read else 0
        wanted |= selectors.EVENT_WRITE if client.wants_to_write else 0
        key = self._selector.get_map().get(descriptor)
        if wanted and key is None:
            self._selector.register(descriptor, wanted, self._ready[descriptor])
        elif wanted and key is not None and key.events != wanted:
            self._selector.modify(descriptor, wanted, key.data)
        elif not wanted and key is not None:
            self._selector.unregister(descriptor)

    def _read(self, descriptor: int, client: BusClient) -> None:
        try:
            client.read(self.simulation.kernel.now_ns)
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
            lost = f"; {client.dropped} frames or answers dropped" if client.dropped else ""
            bad = f"; {client.garbage} times garbage" if client.garbage else ""
            self._report(f"a client has left: {client.name}: {reason}{lost}{bad}")

    def _on_error(self, bus: Bus, now_ns: int) -> None:
        for client in self._clients.values():
            if client.bus is bus:
                client.on_error(now_ns)

    def _on_state(self, controller: Controller, now_ns: int) -> None:
        client = controller.station
        if isinstance(client, BusClient) and controller.state is ErrorState.BUS_OFF:
            self._report(f"the controller of a client has gone bus off: {client.name}")
            client.on_bus_off(now_ns)


def ways_in(addresses: ServedAddresses) -> tuple[str, ...]:
    """Lines to copy and paste, one a way in."""
    ways = [
        f"mdms scan -i mdms -c {addresses.channel}",
        f"python -m can.viewer -i mdms -c {addresses.channel}",
        f"mdms scan -i slcan -c {addresses.device} -b {addresses.bitrate}",
    ]
    if addresses.tcp_port is not None:
        url = f"socket://{LOOPBACK}:{addresses.tcp_port}"
        ways.append(f"mdms scan -i slcan -c {url} -b {addresses.bitrate}")
    return tuple(ways)
