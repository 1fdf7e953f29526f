// A client that does what it is told, for runs of many orders: each line of stdin is a request in
// JSON, {"do": method, "with": [arguments]}, and each line of stdout the answer, {"value"} or
// {"error"}. `connect` begins anew. While it is connected it gives the heartbeat every 0.2 s.
// Argument: modbus or opcua.
// Libraries print there, too.
const say = (line) => process.stdout.write(`${JSON.stringify(line)}\n`);
console.log = console.warn = () => {};
const { connect } = require(`./${process.argv[2]}_client.js`);

const LIMIT_MS = 20000;
let table = null;
// The connection whose last heartbeat is not answered yet. One that is destroyed never answers it.
let beating = null;

setInterval(async () => {
  const mine = table;
  if (mine === null || beating === mine) return;
  beating = mine;
  try {
    await mine.beat();
  } catch {
    // The next request shows that the connection is lost.
  } finally {
    if (beating === mine) beating = null;
  }
}, 200);

async function answer({ do: method, with: values }) {
  if (method === "connect") {
    table?.destroy();
    table = null;
    table = await connect(...values);
    return null;
  }
  if (table === null) throw new Error("not connected");
  return (await table[method](...values)) ?? null;
}

function late() {
  let timer;
  const promise = new Promise((_, reject) => {
    timer = setTimeout(() => reject(new Error("no answer")), LIMIT_MS);
  });
  return { promise, stop: () => clearTimeout(timer) };
}

async function main() {
  for await (const line of require("readline").createInterface({ input: process.stdin })) {
    const limit = late();
    try {
      const value = await Promise.race([answer(JSON.parse(line)), limit.promise]);
      say({ value: typeof value === "object" ? null : value });
    } catch (error) {
      say({ error: error.message });
    } finally {
      limit.stop();
    }
  }
  process.exit(0);
}

process.on("unhandledRejection", () => {});
main();
