// One episode of the octopus arm on a server: makes a world, joins it, steps it to the end of the
// episode, and frees it. The policy is the arm's own teacher, read as a property of the world, so the
// return comes close to 500.

import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";
import { parseArgs } from "node:util";

import grpc from "@grpc/grpc-js";
import { loadSync } from "@grpc/proto-loader";

const USAGE = `usage: node client.mjs [--address HOST:PORT] [--target NAME] [--seed NUMBER] [--ca FILE]

  --address  where the server is (default 127.0.0.1:50051)
  --target   quadratic, van_der_pol or lissajous (default lissajous)
  --seed     of the phase at which the episode begins (default 0)
  --ca       certificate (PEM) that the server's is signed with, or its own: speak TLS

A token is taken from the environment variable OCTOARM_TOKEN.`;

const PROPERTIES = "dm_env_rpc.v1.extensions.properties";
const protocol = loadSync(
  ["dm_env_rpc/v1/dm_env_rpc.proto", "dm_env_rpc/v1/extensions/properties.proto"],
  {
    includeDirs: [fileURLToPath(new URL("../../../protocol/proto", import.meta.url))],
    keepCase: true,
    enums: String,
    longs: String,
    arrays: true,
    oneofs: true,
  },
);
const { Environment } = grpc.loadPackageDefinition(protocol).dm_env_rpc.v1;

/** A stream to a server: one request at a time, and its answer. */
class Connection {
  constructor(address, { token, ca } = {}) {
    const here = /^(127\.[\d.]+|localhost|\[::1\])(:\d+)?$/.test(address);
    if (token && !ca && !here) {
      throw new Error(`${address}: a token is not sent to another machine without TLS: give --ca`);
    }
    const credentials = ca
      ? grpc.credentials.createSsl(readFileSync(ca))
      : grpc.credentials.createInsecure();
    const metadata = new grpc.Metadata();
    if (token) metadata.set("authorization", `Bearer ${token}`);
    // The answer to a step of many arms may be large; a dead server is noticed; to this machine no
    // proxy is asked that http_proxy names.
    this.client = new Environment(address, credentials, {
      "grpc.max_receive_message_length": -1,
      "grpc.keepalive_time_ms": 30_000,
      "grpc.keepalive_timeout_ms": 20_000,
      "grpc.enable_http_proxy": here ? 0 : 1,
    });
    this.stream = this.client.Process(metadata);
    this.answers = this.stream[Symbol.asyncIterator]();
  }

  /** The answer to a request such as { step: {...} }; throws what went wrong. */
  async ask(request) {
    this.stream.write(request);
    const { value: answer, done } = await this.answers.next();
    if (done) throw new Error("the server ended the stream");
    if (answer.payload === "error") {
      const { code, message } = answer.error;
      throw new Error(`the server refused: ${message} (${grpc.status[code] ?? code})`);
    }
    return answer[answer.payload];
  }

  /** The numbers of a property. */
  async read(key) {
    const request = { read_property: { key } };
    const { value } = await this.ask({
      extension: {
        type_url: `type.googleapis.com/${PROPERTIES}.PropertyRequest`,
        value: protocol[`${PROPERTIES}.PropertyRequest`].serialize(request),
      },
    });
    return protocol[`${PROPERTIES}.PropertyResponse`].deserialize(value).read_property.value.doubles
      .array;
  }

  /** Sends nothing more, and waits for the server's end of the stream. */
  async end() {
    this.stream.end();
    await this.answers.next();
  }

  close() {
    this.stream.cancel();
    this.client.close();
  }
}

/** A map of the protocol by decimal numbers; protobufjs keeps its keys as eight bytes in a text. */
function byNumber(map) {
  const decimal = (key) =>
    /^\d+$/.test(key) ? key : String(Buffer.from(key, "latin1").readBigUInt64LE());
  return Object.fromEntries(Object.entries(map).map(([key, value]) => [decimal(key), value]));
}

/** The number on the wire of an action or observation. */
function uid(specs, name) {
  const found = Object.entries(byNumber(specs)).find(([, spec]) => spec.name === name);
  if (!found) throw new Error(`the server does not know ${name}`);
  return found[0];
}

async function episode(connection, target, seed) {
  const { world_name } = await connection.ask({
    create_world: {
      settings: {
        target: { strings: { array: [target] } },
        seed: { uint64s: { array: [seed] } },
      },
    },
  });
  const { specs } = await connection.ask({ join_world: { world_name } });
  const action = uid(specs.actions, "action");
  const reward = uid(specs.observations, "reward");
  const lengths = uid(specs.observations, "spring_lengths");

  // The first step begins the episode: it takes no action, and earns nothing.
  let step = await connection.ask({ step: { requested_observations: [lengths] } });
  const springs = byNumber(step.observations)[lengths].doubles.array;
  console.log(`${springs.length} springs, the first ${springs[0]} m long`);
  let total = 0;
  let steps = 0;
  while (step.state === "RUNNING") {
    const doubles = { array: await connection.read("teacher_action") };
    step = await connection.ask({
      step: {
        actions: { [action]: { doubles, shape: [2] } },
        requested_observations: [reward],
      },
    });
    total += byNumber(step.observations)[reward].doubles.array[0];
    steps += 1;
  }
  console.log(`${steps} steps, ${step.state}, return ${total}`);

  await connection.ask({ leave_world: {} });
  await connection.ask({ destroy_world: { world_name } });
}

async function main() {
  const { values: options } = parseArgs({
    options: {
      address: { type: "string", default: "127.0.0.1:50051" },
      target: { type: "string", default: "lissajous" },
      seed: { type: "string", default: "0" },
      ca: { type: "string" },
      help: { type: "boolean", short: "h" },
    },
  });
  if (options.help) {
    console.log(USAGE);
    return;
  }
  const { address, target, seed, ca } = options;
  if (!/^\d{1,20}$/.test(seed) || BigInt(seed) >= 2n ** 64n) {
    throw new Error(`--seed ${seed}: expected a whole number, 0 to 2^64 - 1`);
  }
  const connection = new Connection(address, { token: process.env.OCTOARM_TOKEN, ca });
  try {
    await episode(connection, target, seed);
    await connection.end();
  } finally {
    connection.close();
  }
}

main().catch((error) => {
  // An error of gRPC says "14 UNAVAILABLE: ...".
  console.error(`client.mjs: ${error.message.trim().replace(/\s+/g, " ")}`);
  process.exitCode = 1;
});
