// Reads an MCAP file with @mcap/core, streamed and by its index, with every check switched on,
// and prints what it found as JSON.  Run by test_other_readers.py; `npm install @mcap/core fzstd`.
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { decompress } from "fzstd";
import { open, readFile } from "node:fs/promises";

const decompressHandlers = {
  zstd: (data, size) => decompress(data, new Uint8Array(Number(size))),
};

async function streamed(path) {
  const found = { messages: {}, sha: {}, attachments: [], metadata: [], dataEnd: 0 };
  const topics = new Map();
  const reader = new McapStreamReader({ validateCrcs: true, decompressHandlers });
  reader.append(await readFile(path));
  for (let record; (record = reader.nextRecord()); ) {
    if (record.type === "Channel") topics.set(record.id, record.topic);
    if (record.type === "Message") {
      const topic = topics.get(record.channelId);
      found.messages[topic] = (found.messages[topic] ?? 0) + 1;
    }
    if (record.type === "Attachment") found.attachments.push(record.name);
    if (record.type === "Metadata") found.metadata.push(record.name);
    if (record.type === "DataEnd") found.dataEnd += 1;
  }
  if (!reader.done() || reader.bytesRemaining() !== 0) throw new Error("the file does not end well");
  return found;
}

async function indexed(path) {
  const file = await open(path);
  const readable = {
    size: async () => BigInt((await file.stat()).size),
    read: async (offset, length) => {
      const data = new Uint8Array(Number(length));
      await file.read(data, 0, Number(length), Number(offset));
      return data;
    },
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const found = { messages: {}, last: "0", attachments: [] };
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    const topic = reader.channelsById.get(message.channelId).topic;
    found.messages[topic] = (found.messages[topic] ?? 0) + 1;
    if (message.logTime < BigInt(found.last)) throw new Error("log times run backwards");
    found.last = message.logTime.toString();
  }
  for await (const attachment of reader.readAttachments({ validateCrcs: true }))
    found.attachments.push(attachment.name);
  await file.close();
  return found;
}

const path = process.argv[2];
console.log(JSON.stringify({ streamed: await streamed(path), indexed: await indexed(path) }));
