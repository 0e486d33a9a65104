// The master of the npm package `canopen` drives a simulated drive: frames go out and come in as
// JSON lines. Arguments: EDS file, node, 1 where the drive takes positions in every cycle.
const readline = require("readline");
const { Device, Eds } = require("canopen");

const [path, node, cyclic] = [process.argv[2], Number(process.argv[3]), process.argv[4] === "1"];
const described = Eds.fromFile(path);
const master = new Device({ id: 0x7e, eds: new Eds() });
const waiting = [];
const WAIT_MS = 5000;

master.eds.addSdoClientParameter(node, 0x600 + node, 0x580 + node);
master.eds.setSyncCobId(0x80);
master.eds.setSyncGenerationEnable(true);
master.addListener("message", ({ id, data }) =>
  process.stdout.write(JSON.stringify({ id, data: data.toString("hex") }) + "\n"));
readline.createInterface({ input: process.stdin }).on("line", (line) => {
  const row = JSON.parse(line);
  if (row.done) return waiting.shift()?.();
  const data = Buffer.from(row.data, "hex");
  master.receive({ id: row.id, data, len: data.length });
});

const object = (index) => ({ deviceId: node, index, timeout: WAIT_MS });
const typed = (index) => ({ ...object(index), dataType: described.getEntry(index).dataType });
const read = (index) => master.sdo.upload(typed(index));
const write = (index, data) => master.sdo.download({ ...typed(index), data });
const told = (mark) => new Promise((next) => {
  waiting.push(next);
  process.stdout.write(JSON.stringify({ mark }) + "\n");
});
const sync = async () => {
  master.sync.write();
  await told("sync");
};
const order = async (word) => {
  await write(0x6040, word);
  await sync();
};

async function enable() {
  await write(0x6060, cyclic ? 8 : 1);
  await sync();
  await write(0x607a, await read(0x6064));
  for (const word of [0x06, 0x07, 0x0f]) await order(word);
  return (await read(0x6041)) & 0x6f;
}

async function move(counts) {
  const start = await read(0x6064);
  if (!cyclic) {
    await write(0x607a, start + counts);
    await order(0x3f);
    await order(0x0f);
  }
  for (let step = 10; step <= counts; step += 10) {
    if (cyclic) await write(0x607a, start + step);
    await sync();
  }
  return (await read(0x6064)) - start;
}

async function main() {
  master.start();
  master.nmt.startNode(node);
  await told("started");
  const found = { vendor: await master.sdo.upload({ ...object(0x1018), subIndex: 1, dataType: 7 }) };
  found.enabled = await enable();
  await told("enabled");
  found.moved = await move(1000);
  await order(0x02);
  for (let n = 0; n < 200; n += 1) await sync();
  found.stopped = (await read(0x6041)) & 0x6f;
  await told("stopped");
  await order(0x00);
  await told("disabled");
  await enable();
  await told("fail");
  for (let n = 0; n < 100; n += 1) await sync();
  found.failed = (await read(0x6041)) & 0x4f;
  await told("failed");
  await order(0x00);
  await order(0x80);
  found.reset = (await read(0x6041)) & 0x4f;
  try {
    await master.sdo.upload({ ...object(0x5fff), dataType: 7 });
    found.refused = "";
  } catch (error) {
    found.refused = String(error.message ?? error);
  }
  process.stdout.write(JSON.stringify({ found }) + "\n", () => process.exit(0));
}

main().catch((error) => {
  process.stdout.write(JSON.stringify({ error: String(error.stack ?? error) }) + "\n", () =>
    process.exit(1));
});
