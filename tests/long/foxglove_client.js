// Foxglove's own client library reads a stream: writes one JSON line a message.
// Arguments: address, output file, seconds without a message after which it ends.
const fs = require("fs");
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const WebSocket = require("ws");

const [address, path, patience] = process.argv.slice(2);
const client = new FoxgloveClient({ ws: new WebSocket(address, ["foxglove.sdk.v1"]) });
const topics = new Map();
const out = fs.createWriteStream(path);
let last = Date.now();

client.on("error", (error) => {
  console.error(error);
  process.exit(1);
});
client.on("advertise", (channels) => {
  for (const channel of channels) {
    topics.set(client.subscribe(channel.id), channel.topic);
  }
});
client.on("message", ({ subscriptionId, timestamp, data }) => {
  last = Date.now();
  const bytes = Buffer.from(data.buffer, data.byteOffset, data.byteLength);
  const row = [topics.get(subscriptionId), timestamp.toString(), bytes.toString("hex")];
  out.write(JSON.stringify(row) + "\n");
});
setInterval(() => {
  if (Date.now() - last > 1000 * Number(patience)) {
    client.close();
    out.end(() => process.exit(0));
  }
}, 200);
