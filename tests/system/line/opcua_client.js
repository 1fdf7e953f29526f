// A controller by node-opcua. By itself: the same as modbus_client.js, by the PackML model.
// Arguments: URL, key, identity, folder of its own certificates.
const {
  OPCUAClient,
  MessageSecurityMode,
  SecurityPolicy,
  UserTokenType,
  AttributeIds,
  DataType,
  makeBrowsePath,
} = require("node-opcua-client");
const { OPCUACertificateManager } = require("node-opcua-certificate-manager");

// Connects to a table; exits are named.
async function connect(url, folder) {
  const clientCertificateManager = new OPCUACertificateManager({
    rootFolder: folder,
    automaticallyAcceptUnknownCertificate: true,
  });
  const client = OPCUAClient.create({
    endpointMustExist: false,
    securityMode: MessageSecurityMode.SignAndEncrypt,
    securityPolicy: SecurityPolicy.Basic256Sha256,
    clientCertificateManager,
    connectionStrategy: { maxRetry: 2 },
    transactionTimeout: 5000,
  });
  await client.connect(url);
  const session = await client.createSession({
    type: UserTokenType.UserName,
    userName: "plc",
    password: "secret",
  });
  const uris = await session.readNamespaceArray();
  const packml = uris.indexOf("http://opcfoundation.org/UA/PackML/");
  const own = uris.indexOf("urn:mdms-array:line");
  const nodes = new Map();
  const node = async (path) => {
    if (!nodes.has(path)) {
      const found = await session.translateBrowsePath(makeBrowsePath("ObjectsFolder", path));
      if (!found.targets?.length) throw new Error(`${path} is not there`);
      nodes.set(path, found.targets[0].targetId);
    }
    return nodes.get(path);
  };
  const line = `/${own}:Table/${own}:Line`;
  const base = `/${own}:Table/${packml}:BaseStateMachine`;
  const machine = `${base}/${packml}:MachineState`;
  const execute = `${machine}/${packml}:ExecuteState`;
  const places = { Clear: base, Abort: base, Stop: machine };
  const call = async (object, method, ...inputArguments) => {
    const objectId = await node(object);
    const methodId = await node(`${object}/${method}`);
    const result = await session.call({ objectId, methodId, inputArguments });
    if (!result.statusCode.isGood()) throw new Error(`refused: ${method}: ${result.statusCode.name}`);
    return result.outputArguments.map((each) => each.value);
  };
  const texts = (...values) => values.map((value) => ({ dataType: DataType.String, value }));
  const asked = (method, ...values) => call(line, `${own}:${method}`, ...values);
  const read = async (name) =>
    (await session.read({ nodeId: await node(`${line}/${own}:${name}`) })).value.value;
  const heartbeat = await node(`${line}/${own}:ClientHeartbeat`);
  const priority = { dataType: DataType.Int32, value: 0 };
  let beats = 0;
  return {
    read,
    beat: () => {
      const value = { dataType: DataType.UInt32, value: ++beats };
      return session.write({ nodeId: heartbeat, attributeId: AttributeIds.Value, value: { value } });
    },
    state: () => read("StateName"),
    command: (name) => call(places[name] ?? execute, `${packml}:${name}`),
    choose: (name) => asked("ChooseRecipe", ...texts(name)),
    order: async (key, parcel, exit) =>
      (await asked("GiveOrderToExit", ...texts(key, parcel, exit), priority))[1],
    ask: async (key) => (await asked("GetOrder", ...texts(key)))[0],
    cancel: (key) => asked("CancelOrder", ...texts(key)),
    coming: (parcel) => asked("ParcelComing", ...texts(parcel, "")),
    gone: (parcel) => asked("ParcelNotComing", ...texts(parcel)),
    full: (exit, full) =>
      asked("SetExitFull", ...texts(exit), { dataType: DataType.Boolean, value: full }),
    close: async () => {
      await session.close();
      await client.disconnect();
    },
    destroy: () => client.disconnect().catch(() => {}),
  };
}

async function main(url, key, parcel, folder) {
  const table = await connect(url, folder);
  const until = async (name, done) => {
    for (const end = Date.now() + 120000; Date.now() < end; ) {
      await table.beat();
      if (await done()) return console.log(name);
      await new Promise((resolve) => setTimeout(resolve, 100));
    }
    throw new Error(`${name}: not reached in ${await table.state()}, ${await table.read("Reason")}`);
  };
  const state = (name) => until(name, async () => (await table.state()) === name);
  const give = () => table.order(key, parcel, "north");
  const refused = async (name, state) => {
    await table.choose(name).catch((error) => console.log(`in ${state}: ${error.message.split(": ")[2]}`));
  };
  console.log(`order ${await give()}, again ${await give()}`);
  await refused("gentle", "Stopped");
  await table.command("Reset");
  await state("Idle");
  await table.choose("gentle");
  await until("recipe gentle", async () => (await table.read("Recipe")) === "gentle");
  await until("beat", async () => true);
  await new Promise((resolve) => setTimeout(resolve, 300));
  await table.command("Start");
  await state("Execute");
  await refused("table", "Execute");
  await until("left", async () => (await table.ask(key)) === "left");
  await table.command("Stop");
  await state("Stopped");
  await table.close();
}

module.exports = { connect };

if (require.main === module) {
  main(...process.argv.slice(2)).then(
    () => process.exit(0),
    (error) => {
      console.error(error.message);
      process.exit(1);
    },
  );
}
