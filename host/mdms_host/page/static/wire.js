// The connection: messages in and out, snapshots unpacked into typed arrays by their names.

const TYPES = { f8: Float64Array, f4: Float32Array, u1: Uint8Array };

/** Where each signal of a description lies in a snapshot: [type, offset, length]. */
function placesOf(signals) {
  const places = {};
  let offset = 8;
  for (const { name, type, shape } of signals) {
    const length = shape.reduce((product, n) => product * n, 1);
    places[name] = [TYPES[type], offset, length];
    offset += length * TYPES[type].BYTES_PER_ELEMENT;
  }
  return { places, size: offset };
}

/** Unpacks snapshots of one description; null for one of another. */
export class Unpacker {
  constructor(description) {
    this.version = description.version;
    ({ places: this.places, size: this.size } = placesOf(description.signals));
  }

  unpack(buffer) {
    if (buffer.byteLength !== this.size) return null;
    if (new DataView(buffer).getUint32(0, true) !== this.version) return null;
    const snapshot = {};
    for (const name in this.places) {
      const [Type, offset, length] = this.places[name];
      snapshot[name] = new Type(buffer, offset, length);
    }
    return snapshot;
  }
}

/** The token of the address, kept for this tab so that a page loaded again still has it. */
function takeToken() {
  const found = new URLSearchParams(location.hash.slice(1)).get("token")
    ?? new URLSearchParams(location.search).get("token");
  if (found) {
    sessionStorage.setItem("token", found);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("token");
}

/**
 * A connection that comes back by itself. Calls `on.message(object)`, `on.snapshot(buffer)` and
 * `on.state(connected)`.
 */
export class Wire {
  constructor(on) {
    this.on = on;
    this.token = takeToken();
    this.number = 0;
    this.waiting = new Map();
    // The address of a host that was started anew differs by its token alone, which loads no page.
    addEventListener("hashchange", () => {
      this.token = takeToken();
      this.socket.close();
    });
    this.open();
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    this.socket = new WebSocket(`${scheme}://${location.host}/api/live`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => {
      this.socket.send(JSON.stringify({ token: this.token }));
      this.on.state(true);
    };
    this.socket.onmessage = ({ data }) => {
      if (typeof data === "string") this.take(JSON.parse(data));
      else this.on.snapshot(data);
    };
    this.socket.onclose = () => {
      for (const answer of this.waiting.values()) answer({ ok: false, text: "the connection is gone" });
      this.waiting.clear();
      this.on.state(false);
      setTimeout(() => this.open(), 1000);
    };
  }

  take(message) {
    if (message.kind === "answer" && this.waiting.has(message.id)) {
      this.waiting.get(message.id)(message);
      this.waiting.delete(message.id);
    }
    this.on.message(message);
  }

  /** Confirms a snapshot, so that the next one comes. */
  seen() {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send('"seen"');
  }

  /** Sends a command; resolves with its answer. */
  ask(command, values = {}) {
    if (this.socket.readyState !== WebSocket.OPEN) {
      return Promise.resolve({ ok: false, text: "not connected" });
    }
    const id = ++this.number;
    this.socket.send(JSON.stringify({ id, command, ...values }));
    return new Promise((resolve) => this.waiting.set(id, resolve));
  }
}
