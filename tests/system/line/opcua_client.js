// A controller by node-opcua: the same by the PackML model. Arguments: URL, key, identity, folder
// of its own certificates.
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

const [url, key, parcel, folder] = process.argv.slice(2);

async function main() {
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
  });
  await client.connect(url);
  const session = await client.createSession({
    type: UserTokenType.UserName,
    userName: "plc",
    password: "secret",
  });
  const uris = await session.readNamespaceArray();
  const packml = uris.indexOf("http://opcfoundation.org/UA/PackML/");
  const line = uris.indexOf("urn:mdms-array:line");
  const node = async (path) => {
    const found = await session.translateBrowsePath(makeBrowsePath("ObjectsFolder", path));
    if (!found.targets?.length) throw new Error(`${path} is not there`);
    return found.targets[0].targetId;
  };
  const table = `/${line}:Table`;
  const execute = `${table}/${packml}:BaseStateMachine/${packml}:MachineState/${packml}:ExecuteState`;
  const machine = `${table}/${packml}:BaseStateMachine/${packml}:MachineState`;
  const read = async (name) =>
    (await session.read({ nodeId: await node(`${table}/${line}:Line/${line}:${name}`) })).value.value;
  const call = async (object, method, ...inputArguments) => {
    const objectId = await node(object);
    const methodId = await node(`${object}/${method}`);
    const result = await session.call({ objectId, methodId, inputArguments });
    if (!result.statusCode.isGood()) throw new Error(`${method}: ${result.statusCode.name}`);
    return result.outputArguments.map((each) => each.value);
  };
  const heartbeat = await node(`${table}/${line}:Line/${line}:ClientHeartbeat`);
  let beat = 0;
  const until = async (name, done) => {
    for (const end = Date.now() + 120000; Date.now() < end; ) {
      const value = { dataType: DataType.UInt32, value: ++beat };
      await session.write({ nodeId: heartbeat, attributeId: AttributeIds.Value, value: { value } });
      if (await done()) return console.log(name);
      await new Promise((resolve) => setTimeout(resolve, 100));
    }
    throw new Error(`${name}: not reached in ${await read("StateName")}, ${await read("Reason")}`);
  };
  const state = (name) => until(name, async () => (await read("StateName")) === name);
  const texts = (...values) => values.map((value) => ({ dataType: DataType.String, value }));
  const priority = { dataType: DataType.Int32, value: 0 };
  const give = () =>
    call(`${table}/${line}:Line`, `${line}:GiveOrderToExit`, ...texts(key, parcel, "north"), priority);
  const choose = (name) => call(`${table}/${line}:Line`, `${line}:ChooseRecipe`, ...texts(name));
  await choose("gentle");
  await until("recipe gentle", async () => (await read("Recipe")) === "gentle");
  console.log(`order ${(await give())[1]}, again ${(await give())[1]}`);
  await call(execute, `${packml}:Reset`);
  await state("Idle");
  await until("beat", async () => true);
  await new Promise((resolve) => setTimeout(resolve, 300));
  await call(execute, `${packml}:Start`);
  await state("Execute");
  await choose("table").catch((error) => console.log(`in Execute: ${error.message.split(": ")[1]}`));
  const order = () => call(`${table}/${line}:Line`, `${line}:GetOrder`, ...texts(key));
  await until("left", async () => (await order())[0] === "left");
  await call(machine, `${packml}:Stop`);
  await state("Stopped");
  await session.close();
  await client.disconnect();
}

main().then(
  () => process.exit(0),
  (error) => {
    console.error(error.message);
    process.exit(1);
  },
);
