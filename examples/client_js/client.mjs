// A client of hapticd in JavaScript (node), with zeromq and @msgpack/msgpack: sets a wall, lets the simulated hand tap it,
// and prints the contact and a sample of telemetry.
//
//     npm ci && node client.mjs [RUNTIME_DIRECTORY]
//
// A daemon on the simulated joystick must run: `hapticd run`. docs/protocol.md describes all messages.
import { decode, encode } from "@msgpack/msgpack";
import { Request, Subscriber } from "zeromq";

const TIMEOUT_MS = 5000;

function runtimeDirectory() {
    const { HAPTICD_RUNTIME_DIR, XDG_RUNTIME_DIR } = process.env;
    const found = process.argv[2] ?? HAPTICD_RUNTIME_DIR ?? (XDG_RUNTIME_DIR && `${XDG_RUNTIME_DIR}/hapticd`);
    if (!found) throw new Error("arguments: name the runtime directory, which `hapticd doctor --paths` prints");
    return found;
}

/** Awaits a promise. Without a daemon ZeroMQ fails with EAGAIN after the time-out of the socket. */
async function inTime(promise, what) {
    try {
        return await promise;
    } catch (error) {
        throw error.code === "EAGAIN" ? new Error(`${what}: nothing within 5 s: does a daemon run?`) : error;
    }
}

/** Sends a request and returns its result. */
async function call(command, method, params) {
    const body = encode({ jsonrpc: "2.0", id: 1, method, params });
    await inTime(command.send(body), method);
    const [frame] = await inTime(command.receive(), method);
    const { error, result } = decode(frame);
    if (error) throw new Error(`${method}: ${error.message} (${error.code})`);
    return result;
}

/** Returns the next message of telemetry for which `wanted` is true. A message has two frames, the topic and a map. */
async function next(telemetry, wanted) {
    for (let left = 2000; left > 0; left--) {
        const [topic, body] = await inTime(telemetry.receive(), "telemetry");
        const message = decode(body);
        if (wanted(topic.toString(), message)) return message;
    }
    throw new Error("telemetry: the expected message did not come: is the device the simulated joystick?");
}

async function run() {
    const directory = runtimeDirectory();
    // Without time-outs the client waits for ever if the daemon has ended.
    const options = { receiveTimeout: TIMEOUT_MS, sendTimeout: TIMEOUT_MS, linger: 0, immediate: true };
    const command = new Request(options);
    const telemetry = new Subscriber({ receiveTimeout: TIMEOUT_MS, linger: 0 });
    command.connect(`ipc://${directory}/hapticd.command`);
    telemetry.connect(`ipc://${directory}/hapticd.telemetry`);

    // `state` arrives 60 times a second. Once it arrives, the subscription to `event` is active, too.
    telemetry.subscribe("event", "state");
    await next(telemetry, (topic) => topic === "state");

    const floor = { kind: "wall", point_m: [0, 0], normal: [0, 1], material: "wood" };
    // `wait`: the answer comes once the servo uses the scene.
    const inForce = await call(command, "set_scene", { scene: { objects: { floor } }, wait: true });
    console.log(`wall in force from tick ${inForce.tick} on`);

    const gesture = { kind: "tap", object: "floor", speed_m_per_s: 0.2 };
    const began = await call(command, "set_operator", { gesture });
    const isContact = (topic, message) => topic === "event" && message.event === "contact" && message.tick >= began.tick;
    const contact = await next(telemetry, isContact);
    const speed = contact.speed_m_per_s.toFixed(3);
    console.log(`contact at tick ${contact.tick} with ${speed} m/s, tap of ${contact.amplitude_m_per_s2.toFixed(1)} m/s^2`);

    const sample = await next(telemetry, (topic) => topic === "state");
    const written = (vector, digits) => vector.map((each) => each.toFixed(digits)).join(" ");
    const position = written(sample.position_m, 5);
    console.log(`sample of tick ${sample.tick}: position ${position} m, force ${written(sample.force_n, 3)} N`);
    command.close();
    telemetry.close();
}

run().catch((error) => {
    console.error(`client: ${error.message}`);
    process.exit(1);
});
