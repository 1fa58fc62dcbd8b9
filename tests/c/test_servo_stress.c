/* The whole servo against its neighbours, as the daemon uses it: one thread publishes tables and sends commands, one
 * drains samples and events, the servo ticks at 10 kHz with the simulated joystick. Meant for the sanitizers; what is
 * asserted is order and completeness, never time. A second servo takes tables that tell only what has changed, many of
 * them overtaken, and must end where a run without servo does. */
#include <malloc.h>
#include <math.h>
#include <pthread.h>
#include <sched.h>
#include <string.h>

#include "api/hd_core.h"
#include "base/hd_atomic.h"
#include "hd_test.h"

#define RATE_HZ 10000.0
#define MAX_FORCE_N 8.9
#define TICKS 5000u
#define REVISIONS 300u
#define GENERATION 512u         /* revisions that an object lives */
#define STROKE_TICKS 2500u      /* that the hand follows one path */
#define PATIENCE_NS 60000000000 /* a defect, not a slow machine */
#define HELD 1024u              /* commands that the servo holds at most */
#define CROWD 64u
#define CROWD_MATERIALS 6u
#define CROWD_BURSTS 100u
#define CROWD_CHANGES 5000u /* more than the servo remembers */
#define CROWD_TICKS 60u     /* three ramps */

static const struct hd_sim_config joystick = {
    .handle_mass_kg = 0.05,
    .handle_damping_n_s_per_m = 0.2,
    .coulomb_friction_n = 0.02,
    .encoder_step_m = 20e-6,
    .max_force_n = MAX_FORCE_N,
    .force_step_n = 0.005,
    .workspace_m = 0.075,
    .force_timeout_s = 0.1,
    .hand_mass_kg = 0.1,
    .hand_stiffness_n_per_m = 500.0,
    .hand_damping_n_s_per_m = 2.0,
    .start_m = {0.0, 0.01},
};

static const struct hd_servo_config config = {
    .stream_timeout_s = 0.02,
    .device_timeout_s = 0.1,
    .rate_hz = RATE_HZ,
    .cpu = -1,
    .realtime = HD_REALTIME_OFF,
    .slot_capacity = 8,
    .sample_capacity = 4096,
    .resolution_m = 20e-6,
    .forces_on = 1,
};

static struct hd_mode ringing(double frequency_hz, double decay_rate_per_s, double force_per_unit) {
    double w = 2.0 * 3.14159265358979323846 * frequency_hz;
    double peak_time_s = atan(w / decay_rate_per_s) / w;

    return (struct hd_mode){
        .rotor_re = exp(-decay_rate_per_s / RATE_HZ) * cos(w / RATE_HZ),
        .rotor_im = exp(-decay_rate_per_s / RATE_HZ) * sin(w / RATE_HZ),
        .decay_rate_per_s = decay_rate_per_s,
        .angular_frequency_rad_per_s = w,
        .end_s = 5.0 / decay_rate_per_s,
        .peak = exp(-decay_rate_per_s * peak_time_s) * sin(w * peak_time_s),
        .peak_time_s = peak_time_s,
        .amplitude_per_unit = force_per_unit / 0.05,
        .force_per_unit = force_per_unit,
        .gain_re = 1.0,
    };
}

enum { FLOOR, SLOPE, SKIN, STONE, OBJECTS };
enum { COMB, PAPER, CELLOPHANE, PIECES, MATERIALS = PIECES };

struct scene {
    struct hd_table table;
    struct hd_object objects[OBJECTS];
    struct hd_material materials[MATERIALS];
    struct hd_piece pieces[PIECES];
    struct hd_noise noise;
    double numbers[4];
};

/* Every revision changes the surfaces; now and then a slot goes to another object. */
static void make_scene(struct scene *scene, uint32_t revision) {
    *scene = (struct scene){
        .table =
            {
                .revision = revision,
                .object_count = OBJECTS - revision % 2,
                .material_count = MATERIALS,
                .piece_count = 2,
                .noise_count = 1,
                .number_count = 4,
                .display_force = 1,
                .display_vibration = 1,
                .field_version = revision,
                .parts_version = revision,
                .all_changed = 1,
                .period_s = 1.0 / RATE_HZ,
                .max_force_n = MAX_FORCE_N,
                .max_speed_m_per_s = 5.0,
                .ramp_s = 0.02,
                .ramp_step = 1.0 / RATE_HZ / 0.02,
                .field = {.force_n = {0.01 * (revision % 5), 0.0}, .damping_n_s_per_m = 0.5},
            },
        .materials =
            {
                [COMB] = {.texture = HD_TEXTURE_STRIKES + revision / 8 % 3,
                          .stiffness_n_per_m = 700.0 + 10.0 * (revision % 20),
                          .damping_n_s_per_m = 0.1,
                          .friction_coefficient = 0.2,
                          .friction_stiffness_n_per_m = 200.0,
                          .spacing_m = 0.002,
                          .width_m = 0.0005,
                          .depth_m = 0.0001,
                          .drag_n_s_per_m = 1.0,
                          .velocity_gain_per_s = 100.0,
                          .force_gain_m_per_s2_per_n = 10.0,
                          .tap = ringing(67.0, 154.0, 15.0),
                          .groove = ringing(200.0, 330.0, 0.05)},
                [PAPER] = {.texture = HD_TEXTURE_NOISE, .stiffness_n_per_m = 600.0, .tap = ringing(67.0, 154.0, 15.0)},
                [CELLOPHANE] = {.heals = revision % 2,
                                .stiffness_n_per_m = 600.0,
                                .rupture_depth_m = 0.001,
                                .rupture = ringing(200.0, 330.0, 1.9)},
            },
        .pieces = {{.material = COMB}, {.from_m = 0.005, .half_ramp_m = 0.001, .material = PAPER}},
        .noise = {.order = 1, .speed_count = 1, .force_count = 1, .velocity_gain_per_s = 20.0, .force_per_unit = 0.05},
        .numbers = {0.0, 0.0, 1.0, -0.4 + 0.01 * (revision % 9)},
        .objects =
            {
                [FLOOR] = {.shape = HD_SHAPE_WALL, .normal = {0.0, 1.0}, .piece_count = 2},
                [SLOPE] = {.shape = HD_SHAPE_WALL, .normal = {0.6, 0.8}, .point_m = {-0.01, 0.0}},
                [SKIN] = {.shape = HD_SHAPE_MEMBRANE,
                          .material = CELLOPHANE,
                          .point_m = {0.0, 0.005},
                          .normal = {0.0, 1.0},
                          .half_m = {0.02, 0.0}},
                [STONE] = {.shape = revision / GENERATION % 2 == 0 ? HD_SHAPE_BOX : HD_SHAPE_DISC,
                           .material = PAPER,
                           .point_m = {0.01, 0.001 * (revision % 3)},
                           .normal = {0.0, 1.0},
                           .half_m = {0.003, 0.003}},
            },
    };
    for (uint32_t i = 0; i < OBJECTS; i++) {
        scene->objects[i].generation = revision / GENERATION;
        scene->objects[i].pose_version = scene->objects[i].surface_version = revision;
    }
    scene->table.objects = scene->objects;
    scene->table.materials = scene->materials;
    scene->table.pieces = scene->pieces;
    scene->table.noises = &scene->noise;
    scene->table.numbers = scene->numbers;
}

struct drain {
    struct hd_servo *servo;
    struct hd_atomic_u32 last;   /* written by main: what is read now is the rest */
    struct hd_atomic_u32 rounds; /* read by main: so often both rings were found empty */
    uint64_t samples;
    uint64_t samples_dropped;
    uint64_t events;
    uint64_t events_dropped;
    uint64_t kinds[HD_EVENT_GESTURE_END + 1];
    struct hd_atomic_u32 mark; /* the last one that was read */
    uint32_t faults;           /* of the last event that tells them */
    uint64_t overruns;         /* times that HD_FAULT_OVERRUN came to them */
    struct hd_sample newest;
    uint32_t event_revision;
};

static void take_sample(struct drain *drain, const struct hd_sample *sample) {
    CHECK(isfinite(sample->force_n[0]) && isfinite(sample->force_n[1]));
    CHECK(hypot(sample->force_n[0], sample->force_n[1]) <= MAX_FORCE_N * (1.0 + 1e-12));
    if (drain->samples > 0) {
        CHECK(sample->tick > drain->newest.tick && sample->time_ns > drain->newest.time_ns);
        CHECK(sample->revision >= drain->newest.revision);
    }
    drain->samples++;
    drain->newest = *sample;
}

static void take_event(struct drain *drain, const struct hd_event *event) {
    CHECK(event->kind >= HD_EVENT_CONTACT && event->kind <= HD_EVENT_GESTURE_END);
    if (event->kind == HD_EVENT_REVISION) {
        CHECK(event->code > drain->event_revision);
        drain->event_revision = event->code;
    }
    /* Every one, in their order, whatever else was dropped. */
    if (event->kind == HD_EVENT_MARK) {
        CHECK(event->code == hd_atomic_u32_load_relaxed(&drain->mark) + 1);
        hd_atomic_u32_store_release(&drain->mark, event->code);
    }
    if (event->kind == HD_EVENT_GESTURE_END)
        CHECK(event->value <= (double)event->tick && event->code <= 1);
    drain->events++;
    drain->kinds[event->kind]++;
    if (event->kind == HD_EVENT_FAULT) {
        drain->overruns += (event->code & ~drain->faults & HD_FAULT_OVERRUN) != 0;
        drain->faults = event->code;
    }
}

static void *drain_rings(void *argument) {
    struct drain *drain = argument;
    struct hd_sample samples[100];
    struct hd_event events[20];
    struct hd_touched touched[HD_TOUCHED_MAX];
    struct hd_histograms histograms;
    uint32_t last;
    size_t count;

    do {
        hd_servo_histograms(drain->servo, &histograms);
        last = hd_atomic_u32_load_acquire(&drain->last);
        while ((count = hd_servo_read_samples(drain->servo, samples, 100, &drain->samples_dropped)) > 0)
            for (size_t i = 0; i < count; i++)
                take_sample(drain, &samples[i]);
        while ((count = hd_servo_read_events(drain->servo, events, 20, &drain->events_dropped)) > 0)
            for (size_t i = 0; i < count; i++)
                take_event(drain, &events[i]);
        count = hd_servo_read_touched(drain->servo, touched);
        CHECK(count <= OBJECTS);
        for (size_t i = 0; i < count; i++)
            CHECK(touched[i].slot < OBJECTS);
        hd_atomic_u32_store_release(&drain->rounds, hd_atomic_u32_load_relaxed(&drain->rounds) + 1);
        sched_yield();
    } while (!last);
    return NULL;
}

/* While the servo stands still: afterwards there is room for all that it leaves next. */
static void await_empty(const struct drain *drain) {
    const uint32_t before = hd_atomic_u32_load_acquire(&drain->rounds);

    while (hd_atomic_u32_load_acquire(&drain->rounds) < before + 2)
        sched_yield();
}

/* All of the ticks are there, whether read or dropped. 1: the last one was read; else the machine kept the thread that
 * drains from running for as long as the ring has room. */
static int last_was_read(const struct drain *drain, const struct hd_counters *counters) {
    CHECK(drain->samples + drain->samples_dropped == counters->ticks);
    CHECK(drain->newest.tick == counters->ticks - 1 || drain->samples_dropped > 0);
    return drain->newest.tick == counters->ticks - 1;
}

/* What the control side is told, before anything runs. */
static void refuses(struct hd_servo *servo, struct scene *scene) {
    struct hd_command command = {.kind = HD_COMMAND_PLAY, .direction = {1.0, 0.0}, .amplitude = (double)NAN};
    struct hd_grant grant;
    uint64_t sequence;

    CHECK(hd_servo_start(servo, &grant) != HD_OK);
    CHECK(hd_servo_send(servo, &command, 1, &sequence) == HD_ERR_INVALID);
    command = (struct hd_command){.kind = 99};
    CHECK(hd_servo_send(servo, &command, 1, &sequence) == HD_ERR_INVALID);
    scene->table.period_s *= 2.0;
    CHECK(hd_servo_publish(servo, &scene->table) == HD_ERR_INVALID);
    scene->table.period_s /= 2.0;
    scene->table.object_count = 9;
    CHECK(hd_servo_publish(servo, &scene->table) == HD_ERR_INVALID);
    scene->table.object_count = OBJECTS;
    scene->table.changed_count = 1;
    CHECK(hd_servo_publish(servo, &scene->table) == HD_ERR_INVALID);
    scene->table.changed_count = 0;
    scene->objects[0].normal[0] = (double)NAN;
    CHECK(hd_servo_publish(servo, &scene->table) == HD_ERR_INVALID);
}

/* Commands of a revision that is not there yet wait for it; a full ring takes all of a batch or none. */
static uint64_t holds_back(struct hd_servo *servo, uint32_t revision) {
    struct hd_command batch[8];
    uint64_t sequence = 0;
    uint64_t before;

    for (size_t i = 0; i < 8; i++)
        batch[i] = (struct hd_command){.kind = HD_COMMAND_FORCES, .revision = revision, .value = 1};
    for (size_t i = 0; i < HELD / 8 - 1; i++)
        CHECK(hd_servo_send(servo, batch, 8, &sequence) == HD_OK);
    CHECK(hd_servo_send(servo, batch, 5, &sequence) == HD_OK);
    before = sequence;
    CHECK(hd_servo_send(servo, batch, 4, &sequence) == HD_ERR_FULL && sequence == before);
    CHECK(hd_servo_send(servo, batch, 3, &sequence) == HD_OK && sequence == HELD);
    return sequence;
}

static size_t make_commands(struct hd_command commands[3], uint32_t revision) {
    double angle = revision;

    commands[0] = (struct hd_command){.kind = HD_COMMAND_PLAY,
                                      .revision = revision,
                                      .direction = {cos(angle), sin(angle)},
                                      .amplitude = 1.0,
                                      .mode = ringing(200.0, 300.0, 1.0)};
    commands[1] = (struct hd_command){.kind = HD_COMMAND_RESET, .revision = revision, .slot = HD_NO_SLOT};
    commands[2] = (struct hd_command){.kind = HD_COMMAND_FORCES, .revision = revision, .value = revision % 16 != 15};
    return revision % 4;
}

static struct hd_counters counters_of(const struct hd_servo *servo) {
    struct hd_counters counters;

    hd_servo_counters(servo, &counters);
    return counters;
}

/* Hot updates with commands among them, for REVISIONS revisions and TICKS ticks at the least. */
static uint32_t command(struct hd_servo *servo, struct drain *drain, uint32_t revision,
                        struct hd_operator *const paths[2]) {
    const uint32_t enough = revision + REVISIONS;
    uint64_t sequence = 0;
    uint64_t tick = 0;
    uint64_t strokes = 0;
    uint32_t marks = 0;

    while (revision < enough || tick < TICKS) {
        struct hd_command commands[5];
        struct scene scene;
        size_t count = make_commands(commands, ++revision);
        uint64_t earlier = tick;
        int status = HD_OK;

        if (counters_of(servo).ticks / STROKE_TICKS >= strokes)
            commands[count++] =
                (struct hd_command){.kind = HD_COMMAND_OPERATOR, .revision = revision, .path = paths[strokes++ % 2]};
        if (marks - hd_atomic_u32_load_acquire(&drain->mark) < HD_MARKS)
            commands[count++] = (struct hd_command){.kind = HD_COMMAND_MARK, .revision = revision, .value = ++marks};
        make_scene(&scene, revision);
        CHECK(hd_servo_publish(servo, &scene.table) == HD_OK);
        while (count > 0 && (status = hd_servo_send(servo, commands, count, &sequence)) == HD_ERR_FULL)
            sched_yield();
        CHECK(status == HD_OK);
        hd_servo_beat(servo);
        /* None, one that lasts, and one that has lapsed: forces fade, and a later HD_COMMAND_FORCES brings them back.
         */
        hd_servo_set_lease(servo, revision % 32 == 10 ? 1 : revision % 3 == 0 ? INT64_MAX : 0);
        while (revision % 32 == 10 && (counters_of(servo).faults & HD_FAULT_LEASE) == 0)
            sched_yield();
        if (revision % 4 == 0) {
            CHECK(hd_servo_wait_revision(servo, revision, PATIENCE_NS, &tick) == HD_OK);
            CHECK(tick >= earlier);
        }
    }
    CHECK(hd_servo_wait_command(servo, sequence, PATIENCE_NS, &tick) == HD_OK);
    while (hd_atomic_u32_load_acquire(&drain->mark) < marks)
        sched_yield();
    return revision;
}

/* ---- Tables that tell only what has changed ---------------------------------------------------------------------- */

/* Walls in every direction, most of them pressed by a probe at the origin, and materials among them; no damping, no
 * friction, no texture, so that what is displayed to a probe at rest follows from the last table alone. */
struct crowd {
    struct hd_table table;
    struct hd_object objects[CROWD];
    struct hd_material materials[CROWD_MATERIALS];
    uint32_t changed[CROWD_CHANGES];
};

static double uniform(uint64_t *seed, double low, double high) {
    return low + (high - low) * (double)(test_random(seed) >> 11) * 0x1p-53;
}

static void place_wall(struct crowd *crowd, uint64_t *seed, uint32_t slot) {
    struct hd_object *object = &crowd->objects[slot];
    double angle = uniform(seed, 0.0, 6.28);
    double depth_m = uniform(seed, -0.0005, 0.001);
    int gone = test_below(seed, 5) == 0;

    *object = (struct hd_object){
        .generation = object->generation + (gone || object->shape == HD_SHAPE_NONE),
        .pose_version = object->pose_version + 1,
        .surface_version = object->surface_version + 1,
        .shape = gone ? HD_SHAPE_NONE : HD_SHAPE_WALL,
        .material = (uint32_t)test_below(seed, CROWD_MATERIALS),
        .normal = {cos(angle), sin(angle)},
        .point_m = {depth_m * cos(angle), depth_m * sin(angle)},
    };
}

static void change_crowd(struct crowd *crowd, uint64_t *seed) {
    struct hd_table *table = &crowd->table;
    uint32_t count = table->object_count;

    table->revision++;
    table->changed_count = (uint32_t)test_below(seed, 4);
    for (uint32_t i = 0; i < table->changed_count; i++) {
        crowd->changed[i] = (uint32_t)test_below(seed, CROWD);
        place_wall(crowd, seed, crowd->changed[i]);
    }
    if (test_below(seed, 3) == 0) {
        table->object_count = CROWD / 2 + (uint32_t)test_below(seed, CROWD / 2 + 1);
        for (uint32_t slot = count; slot < table->object_count; slot++)
            place_wall(crowd, seed, slot);
    }
    if (test_below(seed, 8) == 0) {
        uint32_t material = (uint32_t)test_below(seed, CROWD_MATERIALS);

        table->parts_version++;
        crowd->materials[material].stiffness_n_per_m = uniform(seed, 10.0, 60.0);
        for (uint32_t slot = 0; slot < CROWD; slot++) {
            if (crowd->objects[slot].material == material) {
                crowd->objects[slot].surface_version++;
                crowd->changed[table->changed_count++] = slot;
            }
        }
    }
    if (test_below(seed, 50) == 0) {
        for (uint32_t slot = 0; table->changed_count < CROWD_CHANGES; slot++)
            crowd->changed[table->changed_count++] = slot % CROWD;
    }
}

/* Refused: what it says of the slots must not be lost, nor what the next one says. */
static void publish_refused(struct hd_servo *servo, const struct crowd *crowd) {
    struct crowd bad = *crowd;

    bad.table.objects = bad.objects;
    bad.table.changed = bad.changed;
    bad.table.materials = bad.materials;
    bad.table.changed_count = 2;
    bad.changed[0] = UINT32_MAX;
    bad.changed[1] = 3;
    bad.objects[3].shape = 99;
    bad.table.all_changed = 0;
    CHECK(hd_servo_publish(servo, &bad.table) == HD_ERR_INVALID);
}

static struct hd_sample newest_sample(struct hd_servo *servo) {
    struct hd_sample samples[64];
    struct hd_sample newest = {.tick = 0};
    uint64_t dropped;
    size_t count;

    while ((count = hd_servo_read_samples(servo, samples, 64, &dropped)) > 0)
        newest = samples[count - 1];
    return newest;
}

/* The force at rest at the origin, long after the ramps. */
static void rendered_force(const struct hd_table *table, double force_n[2]) {
    static const double origin[CROWD_TICKS][2];
    static struct hd_sample samples[CROWD_TICKS];
    struct hd_world *world = hd_world_new();
    struct hd_state *state = hd_state_new(CROWD);
    size_t events;

    CHECK(world != NULL && state != NULL && hd_world_load(world, table) == HD_OK);
    CHECK(hd_render(world, state, origin[0], NULL, NULL, CROWD_TICKS, samples, NULL, 0, &events) == HD_OK);
    memcpy(force_n, samples[CROWD_TICKS - 1].contact_force_n, sizeof samples[0].contact_force_n);
    hd_state_free(state);
    hd_world_free(world);
}

/* Forces are off, so nothing moves the handle from where the hand holds it. */
static uint32_t increments(void) {
    static struct crowd crowd;
    struct hd_servo_config quiet = config;
    struct hd_sim_config still = joystick;
    struct hd_sim *sim;
    struct hd_servo *servo;
    struct hd_grant grant;
    uint64_t seed = 9;
    uint32_t compared = 0;
    uint64_t tick;

    quiet.slot_capacity = CROWD;
    quiet.forces_on = 0;
    still.start_m[0] = still.start_m[1] = 0.0;
    sim = hd_sim_new(&still, 1.0 / RATE_HZ);
    servo = hd_servo_new(&quiet, sim, NULL);
    CHECK(sim != NULL && servo != NULL);
    crowd.table = (struct hd_table){
        .revision = 1,
        .object_count = CROWD / 2,
        .material_count = CROWD_MATERIALS,
        .display_force = 1,
        .display_vibration = 1,
        .parts_version = 1,
        .all_changed = 1,
        .period_s = 1.0 / RATE_HZ,
        .max_force_n = MAX_FORCE_N,
        .max_speed_m_per_s = 5.0,
        .ramp_s = 0.002,
        .ramp_step = 1.0 / RATE_HZ / 0.002,
        .objects = crowd.objects,
        .materials = crowd.materials,
        .changed = crowd.changed,
    };
    for (uint32_t i = 0; i < CROWD_MATERIALS; i++)
        crowd.materials[i].stiffness_n_per_m = 20.0 + i;
    for (uint32_t slot = 0; slot < CROWD; slot++)
        place_wall(&crowd, &seed, slot);
    CHECK(hd_servo_publish(servo, &crowd.table) == HD_OK);
    CHECK(hd_servo_start(servo, &grant) == HD_OK);
    for (uint32_t burst = 0; burst < CROWD_BURSTS; burst++) {
        struct hd_sample newest = {.tick = 0};
        double force_n[2];

        for (size_t tables = 1 + test_below(&seed, 12); tables > 0; tables--) {
            crowd.table.all_changed = 0;
            if (test_below(&seed, 20) == 0) {
                publish_refused(servo, &crowd);
                crowd.table.all_changed = 1;
            }
            change_crowd(&crowd, &seed);
            CHECK(hd_servo_publish(servo, &crowd.table) == HD_OK);
            hd_servo_beat(servo);
            if (test_below(&seed, 3) == 0)
                CHECK(hd_servo_wait_revision(servo, crowd.table.revision, PATIENCE_NS, &tick) == HD_OK);
        }
        CHECK(hd_servo_wait_revision(servo, crowd.table.revision, PATIENCE_NS, &tick) == HD_OK);
        while (newest.revision != crowd.table.revision || newest.tick < tick + CROWD_TICKS) {
            struct hd_sample sample = newest_sample(servo);

            newest = sample.tick > 0 ? sample : newest;
            hd_servo_beat(servo);
            sched_yield();
        }
        rendered_force(&crowd.table, force_n);
        for (int axis = 0; axis < 2; axis++)
            CHECK(fabs(newest.contact_force_n[axis] - force_n[axis]) < 1e-12);
        compared += hypot(force_n[0], force_n[1]) > 0.01;
    }
    CHECK(compared > CROWD_BURSTS / 2);
    CHECK(hd_servo_stop(servo) == HD_OK);
    hd_servo_free(servo);
    hd_sim_free(sim);
    return crowd.table.revision;
}

/* A play that waits for the thread takes the mode of another rate; nothing else does. The one after it is a reset. */
static void retunes(struct hd_servo *servo, uint64_t sent, const struct hd_mode *mode) {
    struct hd_mode broken = *mode;

    broken.rotor_re = (double)NAN;
    CHECK(hd_servo_retune(servo, sent + 1, mode) == HD_ERR_INVALID);
    CHECK(hd_servo_retune(servo, sent, mode) == HD_ERR_INVALID);
    CHECK(hd_servo_retune(servo, sent - 1, &broken) == HD_ERR_INVALID);
    CHECK(hd_servo_retune(servo, sent - 1, mode) == HD_OK);
}

/* One more of each stream, whatever the thread does. */
static void send_streams(struct hd_servo *servo, uint64_t *streamed) {
    const double value[2] = {0.01 * (double)(*streamed % 7), 0.01};

    ++*streamed;
    for (uint32_t kind = 0; kind < HD_STREAMS; kind++)
        CHECK(hd_servo_stream(servo, kind, *streamed, value) == HD_OK);
}

/* All that was sent is used, or was overtaken, also while no thread ran. */
static void streams_were_taken(const struct hd_servo *servo, uint64_t streamed) {
    struct hd_stream_counters counters;

    for (uint32_t kind = 0; kind < HD_STREAMS; kind++) {
        hd_servo_stream_counters(servo, kind, &counters);
        CHECK(counters.used + counters.superseded == streamed && counters.seq == streamed);
    }
}

/* A rate that no machine keeps: the servo ends by itself, and goes on at another one over the same state. */
static uint32_t steps_down(void) {
    struct hd_servo_config fast = config;
    struct hd_sim *sim;
    struct hd_servo *servo;
    struct drain drain = {.events = 0};
    struct scene scene;
    struct hd_grant grant;
    struct hd_counters counters;
    struct hd_histograms histograms;
    pthread_t drainer;
    struct hd_command waiting[3];
    uint64_t ended;
    uint64_t sent;
    uint64_t tick;
    uint64_t streamed = 0;
    uint64_t counted = 0;

    make_commands(waiting, 2);
    fast.rate_hz = 100000.0;
    fast.overrun_action = HD_OVERRUN_STEP_DOWN;
    sim = hd_sim_new(&joystick, 1.0 / fast.rate_hz);
    servo = hd_servo_new(&fast, sim, NULL);
    drain.servo = servo;
    CHECK(sim != NULL && servo != NULL);
    make_scene(&scene, 1);
    scene.table.period_s = 1.0 / fast.rate_hz;
    scene.table.ramp_step = scene.table.period_s / scene.table.ramp_s;
    CHECK(hd_servo_publish(servo, &scene.table) == HD_OK);
    CHECK(pthread_create(&drainer, NULL, drain_rings, &drain) == 0);
    CHECK(hd_servo_start(servo, &grant) == HD_OK);
    CHECK(hd_servo_set_rate(servo, RATE_HZ, HD_OVERRUN_WARN) == HD_ERR_INVALID);
    CHECK(hd_servo_restart(servo, 0, &grant) == HD_ERR_INVALID);
    do {
        hd_servo_beat(servo);
        send_streams(servo, &streamed);
        sched_yield();
        hd_servo_counters(servo, &counters);
    } while (counters.running);
    send_streams(servo, &streamed);
    send_streams(servo, &streamed);
    CHECK(counters.overloaded && counters.overloads == 1 && counters.missed_share > 0.0);
    ended = counters.ticks;
    CHECK(hd_servo_send(servo, waiting, 2, &sent) == HD_OK);
    CHECK(hd_servo_retune(servo, sent, &waiting[0].mode) == HD_ERR_INVALID); /* before the rate */
    CHECK(hd_servo_set_rate(servo, RATE_HZ, HD_OVERRUN_WARN) == HD_OK);
    retunes(servo, sent, &waiting[0].mode);
    CHECK(hd_servo_publish(servo, &scene.table) == HD_ERR_INVALID); /* of the former rate */
    CHECK(hd_sim_set_period(sim, &joystick, 1.0 / RATE_HZ) == HD_OK);
    make_scene(&scene, 2);
    CHECK(hd_servo_publish(servo, &scene.table) == HD_OK);
    await_empty(&drain);
    memset(&grant, 0x55, sizeof grant);
    CHECK(hd_servo_restart(servo, HD_FAULT_OVERRUN, &grant) == HD_OK);
    CHECK(grant.scheduler == 0 && grant.affinity == 0 && grant.priority == 0); /* nothing was asked for */
    CHECK(grant.memory == 0 && grant.memory_kind == 0);
    CHECK(hd_servo_wait_revision(servo, 2, PATIENCE_NS, &tick) == HD_OK && tick == ended);
    do {
        hd_servo_beat(servo);
        sched_yield();
        hd_servo_counters(servo, &counters);
    } while (counters.ticks < ended + 100);
    streams_were_taken(servo, streamed);
    CHECK(counters.running && !counters.overloaded && !counters.forces_on);
    /* The machine may have kept this thread from its beats. */
    CHECK((counters.faults | HD_FAULT_CONTROL) == (HD_FAULT_OVERRUN | HD_FAULT_CONTROL));
    CHECK(hd_servo_stop(servo) == HD_OK);
    hd_atomic_u32_store_release(&drain.last, 1);
    CHECK(pthread_join(drainer, NULL) == 0);
    hd_servo_counters(servo, &counters);
    last_was_read(&drain, &counters);
    CHECK(drain.kinds[HD_EVENT_RATE] == 1 && drain.overruns == 1);
    hd_servo_histograms(servo, &histograms);
    for (uint32_t i = 0; i < HD_HISTOGRAM_BINS; i++)
        counted += histograms.work.counts[i];
    CHECK(counted == counters.ticks);
    hd_servo_free(servo);
    hd_sim_free(sim);
    return (uint32_t)ended;
}

/* What the thread uses is the servo's, too: its owner may free it first, as a collector of garbage does. */
static void holds_what_it_uses(void) {
    static const double waypoints[][3] = {{0.0, 0.0, 0.01}, {0.01, 0.01, 0.01}, {0.02, 0.0, 0.01}, {0.03, 0.01, 0.01}};
    static const double rest[] = {0.0, 0.0, 0.01};
    struct hd_command following = {.kind = HD_COMMAND_OPERATOR, .revision = 1};
    struct hd_sim *sim = hd_sim_new(&joystick, 1.0 / RATE_HZ);
    struct hd_servo *servo = hd_servo_new(&config, sim, NULL);
    struct scene scene;
    struct hd_grant grant;
    struct hd_sample sample;
    uint64_t sent;
    uint64_t tick;

    CHECK(sim != NULL && servo != NULL);
#ifdef __GLIBC__
    mallopt(M_PERTURB, 0x55); /* what is freed is overwritten */
#endif
    make_scene(&scene, 1);
    CHECK(hd_servo_publish(servo, &scene.table) == HD_OK);
    CHECK(hd_servo_start(servo, &grant) == HD_OK);
    hd_sim_free(sim);
    for (uint32_t i = 0; i < 3 * HELD; i++) { /* all at rest at once, but the last */
        following.path =
            i + 1 < 3 * HELD ? hd_operator_new(rest, 1, HD_LINEAR) : hd_operator_new(waypoints[0], 4, HD_MINIMUM_JERK);
        while (hd_servo_send(servo, &following, 1, &sent) == HD_ERR_FULL)
            sched_yield();
        hd_operator_free(following.path);
        hd_servo_beat(servo);
    }
    CHECK(sent == 3 * HELD && hd_servo_wait_command(servo, sent, PATIENCE_NS, &tick) == HD_OK);
    do {
        sched_yield();
        hd_servo_beat(servo);
        sample = newest_sample(servo);
    } while (sample.tick < tick + 400);
    CHECK(sample.position_m[0] > 0.008 && sample.position_m[1] > 0.009);
    hd_servo_free(servo);
#ifdef __GLIBC__
    mallopt(M_PERTURB, 0);
#endif
}

int main(void) {
    static const double strokes[][3] = {
        {0.0, 0.0, 0.01}, {0.05, 0.01, -0.005}, {0.1, -0.01, 0.01}, {0.15, 0.0, -0.01}, {0.3, 0.0, 0.01},
    };
    static const double presses[][3] = {{0.0, 0.0, 0.0}, {0.1, 0.0, -0.01}, {0.2, 0.0, 0.012}};
    struct hd_operator *paths[2];
    struct hd_operator *stroke = hd_operator_new(strokes[0], 5, HD_MINIMUM_JERK);
    struct hd_operator *press = hd_operator_new(presses[0], 3, HD_LINEAR);
    struct hd_sim *sim = hd_sim_new(&joystick, 1.0 / RATE_HZ);
    struct hd_servo *servo = hd_servo_new(&config, sim, NULL);
    struct drain drain = {.servo = servo};
    struct scene scene;
    struct hd_grant grant;
    struct hd_counters counters;
    pthread_t drainer;
    uint64_t held;
    uint64_t tick;
    uint32_t revision;
    uint32_t increment;

    CHECK(stroke != NULL && press != NULL && sim != NULL && servo != NULL);
    paths[0] = stroke;
    paths[1] = press;
    make_scene(&scene, 1);
    refuses(servo, &scene);
    make_scene(&scene, 1);
    CHECK(hd_servo_publish(servo, &scene.table) == HD_OK);
    scene.table.max_force_n *= 2.0; /* the limit is the servo's, for as long as it lives */
    CHECK(hd_servo_publish(servo, &scene.table) == HD_ERR_INVALID);
    scene.table.max_force_n /= 2.0;
    held = holds_back(servo, 2);
    /* As the daemon's telemetry: before there is a servo thread. */
    CHECK(pthread_create(&drainer, NULL, drain_rings, &drain) == 0);
    CHECK(hd_servo_start(servo, &grant) == HD_OK);
    CHECK(hd_servo_wait_command(servo, held, 0, &tick) == HD_ERR_TIMEOUT);
    make_scene(&scene, 2);
    CHECK(hd_servo_publish(servo, &scene.table) == HD_OK);
    CHECK(hd_servo_wait_command(servo, held, PATIENCE_NS, &tick) == HD_OK);
    revision = command(servo, &drain, 2, paths);
    CHECK(hd_servo_stop(servo) == HD_OK);
    hd_atomic_u32_store_release(&drain.last, 1);
    CHECK(pthread_join(drainer, NULL) == 0);

    hd_servo_counters(servo, &counters);
    CHECK(!counters.running && counters.revision == revision && counters.ticks >= TICKS);
    CHECK(counters.samples_dropped == drain.samples_dropped && counters.events_dropped == drain.events_dropped);
    if (last_was_read(&drain, &counters)) {
        CHECK(drain.newest.revision == revision);
        CHECK(drain.newest.force_n[0] == 0.0 && drain.newest.force_n[1] == 0.0);
    }
    CHECK(drain.kinds[HD_EVENT_MARK] > 0 && drain.kinds[HD_EVENT_GESTURE_END] > 0);
    CHECK(drain.kinds[HD_EVENT_CONTACT] > 0 && drain.kinds[HD_EVENT_FAULT] > 0 && counters.strikes > 0);
    hd_servo_free(servo);
    hd_sim_free(sim);
    hd_operator_free(stroke);
    hd_operator_free(press);
    holds_what_it_uses();
    increment = increments();
    CHECK(steps_down() > 0);
    printf("test_servo_stress: ok, %llu ticks (%llu skipped, %llu samples dropped), %u and %u revisions, %llu events\n",
           (unsigned long long)counters.ticks, (unsigned long long)counters.skipped,
           (unsigned long long)counters.samples_dropped, revision, increment, (unsigned long long)drain.events);
    return 0;
}
