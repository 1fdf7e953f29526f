// A controller by modbus-serial. By itself: brings the table from Stopped to Execute, has one parcel
// leave by the first exit, and stops. Prints one line a step. Arguments: port, key, identity.
const ModbusRTU = require("modbus-serial");

const NAMES = { 2: "Stopped", 4: "Idle", 5: "Suspended", 6: "Execute", 9: "Aborted", 11: "Held" };
const COMMANDS = { Reset: 1, Start: 2, Stop: 3, Unhold: 5, Unsuspend: 7, Clear: 9 };
const ORDERS = ["unknown", "accepted", "under way", "arrived", "left", "refused", "cancelled", "in doubt"];
const ORDER = 0, CANCEL = 1, COMING = 2, ASK = 3, GONE = 4;

function text(value) {
  const bytes = Buffer.alloc(16);
  bytes.write(value, "ascii");
  return Array.from({ length: 8 }, (_, word) => bytes.readUInt16BE(2 * word));
}

// Connects to a table; exits are counted from 1.
async function connect(port) {
  const client = new ModbusRTU();
  await client.connectTCP("127.0.0.1", { port: Number(port) });
  client.setID(1);
  client.setTimeout(5000);
  const read = async (address, count = 1) => (await client.readHoldingRegisters(address, count)).data;
  let beats = 0;
  let counter = Math.max((await read(103))[0], (await read(224))[0]);
  const next = () => (counter = (counter + 1) & 0xffff);
  // Function 23 writes a request and reads its answer, with no other client in between.
  const request = async (number, key, parcel = "", exit = 0) => {
    const values = [next(), number, exit, 0, 0, 0, 0x8000, ...text(key), ...text(parcel)];
    const [answered, result, state] = (await client.readWriteRegisters(224, 3, 200, values.length, values)).data;
    if (answered !== counter) throw new Error(`request ${number} is not answered`);
    if (result === 2) throw new Error(`refused: request ${number} for ${key} ${parcel}`);
    return { isNew: result === 0, state: ORDERS[state] };
  };
  return {
    read,
    write: (address, value) => client.writeRegister(address, value), // function 6
    beat: () => client.writeRegister(100, (beats = (beats + 1) & 0xffff)),
    state: async () => NAMES[(await read(1))[0]] ?? "between",
    command: async (name) => {
      const answer = await client.readWriteRegisters(103, 2, 101, 2, [COMMANDS[name], next()]);
      const [answered, result] = answer.data;
      if (answered !== counter || result !== 0) throw new Error(`refused: ${name}`);
    },
    order: async (key, parcel, exit) => {
      const values = [next(), ORDER, exit, 0, 0, 0, 0x8000, ...text(key), ...text(parcel)];
      await client.writeRegisters(200, values); // function 16
      const [answered, result] = await read(224, 3);
      if (answered !== counter || result === 2) throw new Error(`refused: order ${key}`);
      return result === 0;
    },
    ask: async (key) => (await request(ASK, key)).state,
    cancel: async (key) => void (await request(CANCEL, key)),
    coming: async (parcel) => void (await request(COMING, "", parcel)),
    gone: async (parcel) => void (await request(GONE, "", parcel)),
    full: (exits) => client.writeRegister(105, exits.reduce((mask, exit) => mask | (1 << (exit - 1)), 0)),
    close: () => new Promise((resolve) => client.close(resolve)),
    destroy: () => client.destroy(() => {}),
  };
}

async function main(port, key, parcel) {
  const table = await connect(port);
  const until = async (name, done) => {
    for (const end = Date.now() + 120000; Date.now() < end; ) {
      await table.beat();
      if (await done()) return console.log(name);
      await new Promise((resolve) => setTimeout(resolve, 100));
    }
    throw new Error(`${name}: not reached; the first registers are ${await table.read(0, 20)}`);
  };
  const command = async (name, state) => {
    await table.command(name);
    await until(state, async () => (await table.state()) === state);
  };
  const first = await table.order(key, parcel, 1);
  const again = await table.order(key, parcel, 1);
  console.log(`order ${first ? 0 : 1}, again ${again ? 0 : 1}`);
  await command("Reset", "Idle");
  await table.write(107, 2);
  await until("recipe 2", async () => (await table.read(9))[0] === 2);
  await command("Start", "Execute");
  await until("left", async () => (await table.ask(key)) === "left");
  await command("Stop", "Stopped");
  table.close();
}

module.exports = { connect };

if (require.main === module) {
  main(...process.argv.slice(2)).catch((error) => {
    console.error(error.message);
    process.exit(1);
  });
}
