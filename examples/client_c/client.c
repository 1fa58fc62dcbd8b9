/* A client of hapticd in C, with libzmq and msgpack-c: sets a wall, lets the simulated hand tap it, and prints the contact
 * and a sample of telemetry.
 *
 *     make && ./client [RUNTIME_DIRECTORY]
 *
 * A daemon on the simulated joystick must run: `hapticd run`. docs/protocol.md describes all messages. */
#include <inttypes.h>
#include <msgpack.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <zmq.h>

enum { TIMEOUT_MS = 5000, MESSAGES = 2000 };

static void fail(const char *what, const char *why)
{
    fprintf(stderr, "client: %s: %s\n", what, why);
    exit(1);
}

/* ---- msgpack: writing and reading maps ------------------------------------------------------------------------------ */

static void put(msgpack_packer *out, const char *text)
{
    msgpack_pack_str_with_body(out, text, strlen(text));
}

static void put_pair(msgpack_packer *out, const char *key, double x, double y)
{
    put(out, key);
    msgpack_pack_array(out, 2);
    msgpack_pack_double(out, x);
    msgpack_pack_double(out, y);
}

static void put_text(msgpack_packer *out, const char *key, const char *text)
{
    put(out, key);
    put(out, text);
}

/* Returns the member of a map, or NULL. */
static const msgpack_object *member(const msgpack_object *map, const char *key)
{
    if (map == NULL || map->type != MSGPACK_OBJECT_MAP)
        return NULL;
    for (uint32_t i = 0; i < map->via.map.size; i++) {
        const msgpack_object_kv *each = &map->via.map.ptr[i];
        if (each->key.type == MSGPACK_OBJECT_STR && each->key.via.str.size == strlen(key) &&
            memcmp(each->key.via.str.ptr, key, strlen(key)) == 0)
            return &each->val;
    }
    return NULL;
}

static int is_text(const msgpack_object *value, const char *text)
{
    return value != NULL && value->type == MSGPACK_OBJECT_STR && value->via.str.size == strlen(text) &&
           memcmp(value->via.str.ptr, text, strlen(text)) == 0;
}

/* Returns a number, which may be an integer. */
static double number(const msgpack_object *value)
{
    if (value == NULL)
        fail("answer", "a member is missing");
    switch (value->type) {
    case MSGPACK_OBJECT_POSITIVE_INTEGER:
        return (double)value->via.u64;
    case MSGPACK_OBJECT_NEGATIVE_INTEGER:
        return (double)value->via.i64;
    case MSGPACK_OBJECT_FLOAT32:
    case MSGPACK_OBJECT_FLOAT64:
        return value->via.f64;
    default:
        fail("answer", "a member is not a number");
        return 0;
    }
}

static double at(const msgpack_object *list, uint32_t index)
{
    if (list == NULL || list->type != MSGPACK_OBJECT_ARRAY || list->via.array.size <= index)
        fail("answer", "a vector is missing");
    return number(&list->via.array.ptr[index]);
}

/* ---- ZeroMQ --------------------------------------------------------------------------------------------------------- */

static void *connected(void *context, int kind, const char *directory, const char *name)
{
    char address[256];
    int timeout = TIMEOUT_MS, zero = 0, one = 1;
    if (snprintf(address, sizeof address, "ipc://%s/%s", directory, name) >= (int)sizeof address)
        fail(directory, "the name is too long for a socket");
    void *socket = zmq_socket(context, kind);
    /* Without time-outs the client waits for ever if the daemon has ended. */
    zmq_setsockopt(socket, ZMQ_RCVTIMEO, &timeout, sizeof timeout);
    zmq_setsockopt(socket, ZMQ_SNDTIMEO, &timeout, sizeof timeout);
    zmq_setsockopt(socket, ZMQ_LINGER, &zero, sizeof zero);
    zmq_setsockopt(socket, ZMQ_IMMEDIATE, &one, sizeof one);
    if (zmq_connect(socket, address) != 0)
        fail(address, zmq_strerror(zmq_errno()));
    return socket;
}

/* Receives the next frame and unpacks its map; msgpack_unpacked_destroy releases it. */
static void receive(void *socket, const char *from, msgpack_unpacked *into)
{
    zmq_msg_t frame;
    zmq_msg_init(&frame);
    if (zmq_msg_recv(&frame, socket, 0) < 0)
        fail(from, zmq_errno() == EAGAIN ? "nothing came within 5 s: does a daemon run?" : zmq_strerror(zmq_errno()));
    /* The unpacked map owns a copy: its strings stay valid after the frame is closed. */
    if (msgpack_unpack_next(into, zmq_msg_data(&frame), zmq_msg_size(&frame), NULL) != MSGPACK_UNPACK_SUCCESS)
        fail(from, "the message is not msgpack");
    zmq_msg_close(&frame);
}

/* Begins a request: a map of jsonrpc, id, method and params, whose map the caller packs. */
static void begin(msgpack_packer *out, const char *method)
{
    msgpack_pack_map(out, 4);
    put_text(out, "jsonrpc", "2.0");
    put(out, "id");
    msgpack_pack_int(out, 1);
    put_text(out, "method", method);
    put(out, "params");
}

/* Sends a request and returns the tick of its result. */
static uint64_t call(void *command, const char *method, const msgpack_sbuffer *body)
{
    if (zmq_send(command, body->data, body->size, 0) < 0)
        fail(method, zmq_errno() == EAGAIN ? "no daemon took it within 5 s: does one run?" : zmq_strerror(zmq_errno()));
    msgpack_unpacked answer;
    msgpack_unpacked_init(&answer);
    receive(command, method, &answer);
    const msgpack_object *error = member(&answer.data, "error");
    if (error != NULL) {
        const msgpack_object *message = member(error, "message");
        if (message == NULL || message->type != MSGPACK_OBJECT_STR)
            fail(method, "an error without a message");
        fprintf(stderr, "client: %s: %.*s (%.0f)\n", method, (int)message->via.str.size, message->via.str.ptr,
                number(member(error, "code")));
        exit(1);
    }
    uint64_t tick = (uint64_t)number(member(member(&answer.data, "result"), "tick"));
    msgpack_unpacked_destroy(&answer);
    return tick;
}

/* Receives a message of telemetry, which has two frames: the topic and a map. Returns whether it has this topic. */
static int telemetry(void *socket, const char *wanted, msgpack_unpacked *into)
{
    char topic[16] = "";
    if (zmq_recv(socket, topic, sizeof topic - 1, 0) < 0)
        fail("telemetry", zmq_errno() == EAGAIN ? "nothing came within 5 s: does a daemon run?" : zmq_strerror(zmq_errno()));
    receive(socket, "telemetry", into);
    return strcmp(topic, wanted) == 0;
}

/* ---- The wall and the tap -------------------------------------------------------------------------------------------- */

static void put_wall_in_force(void *command)
{
    msgpack_sbuffer body;
    msgpack_packer out;
    msgpack_sbuffer_init(&body);
    msgpack_packer_init(&out, &body, msgpack_sbuffer_write);
    begin(&out, "set_scene");
    msgpack_pack_map(&out, 2);
    put(&out, "wait"); /* the answer comes once the servo uses the scene */
    msgpack_pack_true(&out);
    put(&out, "scene");
    msgpack_pack_map(&out, 1);
    put(&out, "objects");
    msgpack_pack_map(&out, 1);
    put(&out, "floor");
    msgpack_pack_map(&out, 4);
    put_text(&out, "kind", "wall");
    put_text(&out, "material", "wood");
    put_pair(&out, "point_m", 0, 0);
    put_pair(&out, "normal", 0, 1);
    printf("wall in force from tick %" PRIu64 " on\n", call(command, "set_scene", &body));
    msgpack_sbuffer_destroy(&body);
}

static uint64_t tap(void *command)
{
    msgpack_sbuffer body;
    msgpack_packer out;
    msgpack_sbuffer_init(&body);
    msgpack_packer_init(&out, &body, msgpack_sbuffer_write);
    begin(&out, "set_operator");
    msgpack_pack_map(&out, 1);
    put(&out, "gesture");
    msgpack_pack_map(&out, 3);
    put_text(&out, "kind", "tap");
    put_text(&out, "object", "floor");
    put(&out, "speed_m_per_s");
    msgpack_pack_double(&out, 0.2);
    uint64_t tick = call(command, "set_operator", &body);
    msgpack_sbuffer_destroy(&body);
    return tick;
}

int main(int argc, char **argv)
{
    char of_user[256];
    const char *directory = argc > 1 ? argv[1] : getenv("HAPTICD_RUNTIME_DIR");
    if (directory == NULL) {
        const char *runtime = getenv("XDG_RUNTIME_DIR");
        if (runtime == NULL)
            fail("arguments", "name the runtime directory, which `hapticd doctor --paths` prints");
        snprintf(of_user, sizeof of_user, "%s/hapticd", runtime);
        directory = of_user;
    }
    void *context = zmq_ctx_new();
    void *command = connected(context, ZMQ_REQ, directory, "hapticd.command");
    void *listening = connected(context, ZMQ_SUB, directory, "hapticd.telemetry");
    msgpack_unpacked message;
    msgpack_unpacked_init(&message);

    /* `state` arrives 60 times a second. Once it arrives, the subscription to `event` is active, too. */
    zmq_setsockopt(listening, ZMQ_SUBSCRIBE, "event", 5);
    zmq_setsockopt(listening, ZMQ_SUBSCRIBE, "state", 5);
    while (!telemetry(listening, "state", &message))
        ;

    put_wall_in_force(command);
    uint64_t began = tap(command);
    int left = MESSAGES; /* half a minute of states */
    while (!(telemetry(listening, "event", &message) && is_text(member(&message.data, "event"), "contact") &&
             number(member(&message.data, "tick")) >= (double)began))
        if (--left == 0)
            fail("telemetry", "no contact came: is the device the simulated joystick?");
    printf("contact at tick %.0f with %.3f m/s, tap of %.1f m/s^2\n", number(member(&message.data, "tick")),
           number(member(&message.data, "speed_m_per_s")), number(member(&message.data, "amplitude_m_per_s2")));

    while (!telemetry(listening, "state", &message))
        ;
    const msgpack_object *position = member(&message.data, "position_m"), *force = member(&message.data, "force_n");
    printf("sample of tick %.0f: position %.5f %.5f m, force %.3f %.3f N\n", number(member(&message.data, "tick")),
           at(position, 0), at(position, 1), at(force, 0), at(force, 1));

    msgpack_unpacked_destroy(&message);
    zmq_close(listening);
    zmq_close(command);
    zmq_ctx_term(context);
    return 0;
}
