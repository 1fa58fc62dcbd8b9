// A client of hapticd in C++, with cppzmq and msgpack-cxx: sets a wall, lets the simulated hand tap it, and prints the
// contact and a sample of telemetry.
//
//     make && ./client [RUNTIME_DIRECTORY]
//
// A daemon on the simulated joystick must run: `hapticd run`. docs/protocol.md describes all messages.
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <msgpack.hpp>
#include <stdexcept>
#include <string>
#include <zmq.hpp>

namespace {

constexpr int TIMEOUT_MS = 5000;
using Map = std::map<std::string, msgpack::object>;
using Vector = std::array<double, 2>;
using Error = std::runtime_error;

zmq::socket_t connected(zmq::context_t &context, zmq::socket_type kind, const std::string &address)
{
    zmq::socket_t socket(context, kind);
    // Without time-outs the client waits for ever if the daemon has ended.
    socket.set(zmq::sockopt::rcvtimeo, TIMEOUT_MS);
    socket.set(zmq::sockopt::sndtimeo, TIMEOUT_MS);
    socket.set(zmq::sockopt::linger, 0);
    socket.set(zmq::sockopt::immediate, true);
    socket.connect(address);
    return socket;
}

zmq::message_t frame_of(zmq::socket_t &socket)
{
    zmq::message_t frame;
    if (!socket.recv(frame))
        throw Error("nothing came within 5 s: does a daemon run?");
    return frame;
}

// A received map, with the memory of its members.
struct Message {
    msgpack::object_handle memory;
    Map members;

    explicit Message(const zmq::message_t &frame)
        : memory(msgpack::unpack(frame.data<char>(), frame.size())), members(memory->as<Map>())
    {
    }

    template <typename T> T at(const std::string &key) const { return members.at(key).as<T>(); }
};

// Sends a request and returns the tick of its result. `params` packs the map of its parameters.
template <typename Params> std::uint64_t call(zmq::socket_t &command, const std::string &method, const Params &params)
{
    msgpack::sbuffer body;
    msgpack::packer<msgpack::sbuffer> out(body);
    out.pack_map(4);
    out.pack("jsonrpc").pack("2.0").pack("id").pack(1).pack("method").pack(method).pack("params");
    params(out);
    if (!command.send(zmq::buffer(body.data(), body.size())))
        throw Error(method + ": no daemon took it within 5 s: does one run?");
    const Message answer(frame_of(command));
    if (answer.members.count("error")) {
        const Map error = answer.at<Map>("error");
        throw Error(method + ": " + error.at("message").as<std::string>() + " (" + std::to_string(error.at("code").as<int>()) +
                    ")");
    }
    return answer.at<Map>("result").at("tick").as<std::uint64_t>();
}

// Returns the next message of a topic and skips others. A message has two frames, the topic and a map.
Message next(zmq::socket_t &telemetry, const std::string &wanted, int most)
{
    for (; most > 0; most--) {
        const std::string topic = frame_of(telemetry).to_string();
        Message message(frame_of(telemetry));
        if (topic == wanted)
            return message;
    }
    throw Error("telemetry: no " + wanted + " came: is the device the simulated joystick?");
}

void run(const std::string &directory)
{
    zmq::context_t context;
    zmq::socket_t command = connected(context, zmq::socket_type::req, "ipc://" + directory + "/hapticd.command");
    zmq::socket_t telemetry = connected(context, zmq::socket_type::sub, "ipc://" + directory + "/hapticd.telemetry");

    // `state` arrives 60 times a second. Once it arrives, the subscription to `event` is active, too.
    telemetry.set(zmq::sockopt::subscribe, "event");
    telemetry.set(zmq::sockopt::subscribe, "state");
    next(telemetry, "state", 2000);

    const std::uint64_t in_force = call(command, "set_scene", [](auto &out) {
        out.pack_map(2);
        out.pack("wait").pack(true); // the answer comes once the servo uses the scene
        out.pack("scene").pack_map(1).pack("objects").pack_map(1).pack("floor").pack_map(4);
        out.pack("kind").pack("wall").pack("material").pack("wood");
        out.pack("point_m").pack(Vector{0, 0}).pack("normal").pack(Vector{0, 1});
    });
    std::printf("wall in force from tick %llu on\n", static_cast<unsigned long long>(in_force));

    const std::uint64_t began = call(command, "set_operator", [](auto &out) {
        out.pack_map(1).pack("gesture").pack_map(3);
        out.pack("kind").pack("tap").pack("object").pack("floor").pack("speed_m_per_s").pack(0.2);
    });
    for (;;) {
        const Message event = next(telemetry, "event", 2000);
        if (event.at<std::string>("event") != "contact" || event.at<std::uint64_t>("tick") < began)
            continue;
        std::printf("contact at tick %llu with %.3f m/s, tap of %.1f m/s^2\n",
                    static_cast<unsigned long long>(event.at<std::uint64_t>("tick")), event.at<double>("speed_m_per_s"),
                    event.at<double>("amplitude_m_per_s2"));
        break;
    }

    const Message sample = next(telemetry, "state", 2000);
    const Vector position = sample.at<Vector>("position_m"), force = sample.at<Vector>("force_n");
    std::printf("sample of tick %llu: position %.5f %.5f m, force %.3f %.3f N\n",
                static_cast<unsigned long long>(sample.at<std::uint64_t>("tick")), position[0], position[1], force[0],
                force[1]);
}

std::string runtime_directory(int argc, char **argv)
{
    if (argc > 1)
        return argv[1];
    if (const char *named = std::getenv("HAPTICD_RUNTIME_DIR"))
        return named;
    if (const char *runtime = std::getenv("XDG_RUNTIME_DIR"))
        return std::string(runtime) + "/hapticd";
    throw Error("arguments: name the runtime directory, which `hapticd doctor --paths` prints");
}

} // namespace

int main(int argc, char **argv)
{
    try {
        run(runtime_directory(argc, argv));
    } catch (const std::exception &error) {
        std::fprintf(stderr, "client: %s\n", error.what());
        return 1;
    }
    return 0;
}
