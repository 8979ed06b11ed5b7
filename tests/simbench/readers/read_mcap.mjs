// Prints every message of a recording as a line of JSON: topic, log time, message. NaN is null.
import { open } from "node:fs/promises";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers } from "@mcap/support";

const plain = (_, value) => (ArrayBuffer.isView(value) ? Array.from(value) : value);

const file = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(await open(process.argv[2])),
  decompressHandlers: await loadDecompressHandlers(),
});
const readers = new Map();
for (const [id, schema] of file.schemasById) {
  readers.set(id, new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true })));
}
for await (const { channelId, logTime, data } of file.readMessages()) {
  const { topic, schemaId } = file.channelsById.get(channelId);
  const reader = readers.get(schemaId);
  const message = reader.readMessage(data);
  if (reader.lastReadHadTrailingBytes()) throw new Error(`${topic}: bytes are left over`);
  console.log(JSON.stringify([topic, String(logTime), message], plain));
}
