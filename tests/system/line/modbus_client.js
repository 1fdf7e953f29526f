// A controller by modbus-serial: brings the table from Stopped to Execute, has one parcel leave by
// the first exit, and stops. Prints one line a step. Arguments: port, key, identity.
const ModbusRTU = require("modbus-serial");

const [port, key, parcel] = process.argv.slice(2);
const READ = { state: 1 };
const STATES = { Stopped: 2, Idle: 4, Execute: 6 };
const client = new ModbusRTU();
let beat = 0;
let counter = 0;

function text(value) {
  const bytes = Buffer.alloc(16);
  bytes.write(value, "ascii");
  return Array.from({ length: 8 }, (_, word) => bytes.readUInt16BE(2 * word));
}

async function read(address, count = 1) {
  return (await client.readHoldingRegisters(address, count)).data;
}

async function until(name, done) {
  for (const end = Date.now() + 120000; Date.now() < end; ) {
    await client.writeRegister(100, (beat = (beat + 1) & 0xffff)); // function 6
    if (await done()) {
      console.log(name);
      return;
    }
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
  throw new Error(`${name}: not reached; the first registers are ${await read(0, 20)}`);
}

async function command(number, name) {
  const answer = await client.readWriteRegisters(103, 2, 101, 2, [number, ++counter]); // 23
  const [answered, result] = answer.data;
  if (answered !== counter || result !== 0) throw new Error(`command ${number} is refused`);
  await until(name, async () => (await read(READ.state))[0] === STATES[name]);
}

async function request(number, exit) {
  const values = [++counter, number, exit, 0, 0, 0, 0x8000, ...text(key), ...text(parcel)];
  await client.writeRegisters(200, values); // function 16
  return read(224, 3);
}

async function main() {
  await client.connectTCP("127.0.0.1", { port: Number(port) });
  client.setID(1);
  counter = Math.max((await read(103))[0], (await read(224))[0]);
  const [, first] = await request(0, 1);
  const [, again] = await request(0, 1);
  console.log(`order ${first}, again ${again}`);
  await command(1, "Idle");
  await client.writeRegister(107, 2);
  await until("recipe 2", async () => (await read(9))[0] === 2);
  await command(2, "Execute");
  await until("left", async () => (await request(3, 0))[2] === 4);
  await command(3, "Stopped");
  client.close();
}

main().catch((error) => {
  console.error(error.message);
  process.exit(1);
});
