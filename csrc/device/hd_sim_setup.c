/* The control side of the simulated joystick: checks its configuration, makes it, sets its period and its position. */
#include "device/hd_sim_state.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Largest number of parts of a period; a device that needs more at its rate is refused. */
#define HD_PARTS_MAX 2000
#define HD_MAX_STEP_PERIODS 1048576u /* largest number of periods in one step */
#define HD_SAMPLES_A_PERIOD_MAX 64.0 /* largest number of reports, or frames of the link, in a period */
/* Largest number of steps of a resolution (2^50), up to which rounding is exact. */
#define HD_STEPS_MAX 1125899906842624.0
/* Highest speed at which a handle can be placed; above it products overflow. */
#define HD_PLACED_MAX_M_PER_S 1e6

static int check_between(const char *name, double value, double low, double high) {
    if (!(value >= low && value <= high)) {
        return hd_invalid("%s: %g is not between %g and %g", name, value, low, high);
    }
    return HD_OK;
}

/* Checks a resolution: 0 for exact, or coarse enough for HD_STEPS_MAX. */
static int check_step(const char *name, double step, double range) {
    if (step != 0.0 && !(step >= range / HD_STEPS_MAX && step <= 1e6)) {
        return hd_invalid("%s: %g is neither 0 nor between %g and 1e+06", name, step, range / HD_STEPS_MAX);
    }
    return HD_OK;
}

static double fastest_rate_per_s(const struct hd_sim_config *config) {
    const double mass_kg = config->handle_mass_kg + config->hand_mass_kg;
    const double damped = (config->handle_damping_n_s_per_m + config->hand_damping_n_s_per_m) / mass_kg;
    return fmax(damped, sqrt(config->hand_stiffness_n_per_m / mass_kg));
}

/* Checks bounds that keep all products of the simulation finite and all loops short; far beyond any real device. */
static int check_config(const struct hd_sim_config *config, double period_s) {
    const struct {
        const char *name;
        double value;
        double low;
        double high;
    } ranges[] = {
        {"period_s", period_s, 1e-6, 10.0},
        {"handle_mass_kg", config->handle_mass_kg, 1e-6, 1e6},
        {"handle_damping_n_s_per_m", config->handle_damping_n_s_per_m, 0.0, 1e9},
        {"coulomb_friction_n", config->coulomb_friction_n, 0.0, 1e6},
        {"max_force_n", config->max_force_n, 0.0, 1e6},
        {"report_interval_s", config->report_interval_s, 0.0, 1000.0},
        {"report_delay_s", config->report_delay_s, 0.0, 1000.0},
        {"force_interval_s", config->force_interval_s, 0.0, 1000.0},
        {"workspace_m", config->workspace_m, 1e-6, 1000.0},
        {"force_timeout_s", config->force_timeout_s, 1e-6, 1e6},
        {"hand_mass_kg", config->hand_mass_kg, 0.0, 1e6},
        {"hand_stiffness_n_per_m", config->hand_stiffness_n_per_m, 0.0, 1e9},
        {"hand_damping_n_s_per_m", config->hand_damping_n_s_per_m, 0.0, 1e9},
        {"actuator_rate_per_s", config->actuator_rate_per_s, 0.0, 1e7},
        {"actuator_damping_ratio", config->actuator_damping_ratio, 0.0, 10.0},
        {"start_m[0]", config->start_m[0], -config->workspace_m, config->workspace_m},
        {"start_m[1]", config->start_m[1], -config->workspace_m, config->workspace_m},
    };
    for (size_t i = 0; i < sizeof ranges / sizeof ranges[0]; i++) {
        const int status = check_between(ranges[i].name, ranges[i].value, ranges[i].low, ranges[i].high);
        if (status != HD_OK) {
            return status;
        }
    }
    if (check_step("encoder_step_m", config->encoder_step_m, config->workspace_m) != HD_OK ||
        check_step("force_step_n", config->force_step_n, config->max_force_n) != HD_OK) {
        return HD_ERR_INVALID;
    }
    const double interval_s = config->report_interval_s == 0.0 ? period_s : config->report_interval_s;
    if (interval_s * HD_SAMPLES_A_PERIOD_MAX < period_s) {
        return hd_invalid("report_interval_s: %g is less than 1/%g of the period", interval_s, HD_SAMPLES_A_PERIOD_MAX);
    }
    if (config->report_delay_s / interval_s > (double)HD_SAMPLES - 4.0) {
        return hd_invalid("report_delay_s: %g is more than %g reports of %g s", config->report_delay_s,
                          (double)HD_SAMPLES - 4.0, interval_s);
    }
    if (config->force_interval_s > 0.0) {
        if (config->force_interval_s * HD_SAMPLES_A_PERIOD_MAX < period_s) {
            return hd_invalid("force_interval_s: %g is less than 1/%g of the period", config->force_interval_s,
                              HD_SAMPLES_A_PERIOD_MAX);
        }
        if (config->force_intervals < 1 || config->force_intervals > HD_SIM_FORCES) {
            return hd_invalid("force_intervals: %u is not between 1 and %d", config->force_intervals, HD_SIM_FORCES);
        }
    }
    if (config->actuator_order > 2 || (config->actuator_order > 0 && config->actuator_rate_per_s == 0.0)) {
        return hd_invalid("actuator_order: %u with a rate of %g 1/s must be 0, or 1 or 2 with a rate above 0",
                          config->actuator_order, config->actuator_rate_per_s);
    }
    if (hd_actuator_fastest(config) * period_s > HD_STEP_MAX * HD_PARTS_MAX) {
        return hd_invalid("actuator_rate_per_s: %g is too fast for a period of %g s", config->actuator_rate_per_s,
                          period_s);
    }
    if (fastest_rate_per_s(config) * period_s > HD_STEP_MAX * HD_PARTS_MAX) {
        return hd_invalid("handle_mass_kg: %g is too light for its damping, the hand and a period of %g s",
                          config->handle_mass_kg, period_s);
    }
    return HD_OK;
}

/* Computes the power series of J_4 and J_5 without the factor h^(j+2)/5!. */
static void make_series(struct hd_sim *sim) {
    const double damped = (sim->damping + sim->hand_damping) / sim->mass_kg;
    const double elastic = sim->stiffness / sim->mass_kg;
    double before = 0.0;
    double coefficient = 1.0;
    double factorial = 6.0; /* (n + 6)!/5! */
    for (int n = 0; n < HD_SERIES_TERMS; n++) {
        sim->series[0][n] = coefficient / sim->mass_kg / factorial;
        factorial *= n + 7;
        sim->series[1][n] = coefficient / sim->mass_kg / factorial;
        const double next = -damped * coefficient - elastic * before;
        before = coefficient;
        coefficient = next;
    }
}

/* Restarts the encoder samples with the present position as number 0, and drops the forces under way. */
static void restart_samples(struct hd_sim *sim) {
    sim->origin_tick = sim->tick;
    sim->sample_count = 0;
    sim->sample_at = 0;
    sim->read_number = 0;
    sim->read_next_at = sim->sample_interval + sim->sample_delay;
    sim->read_before = false;
    sim->sent_count = 0;
    sim->arrive_at = UINT64_MAX;
    hd_sim_sample(sim);
}

/* Computes all members that depend on the period. */
static void set_period(struct hd_sim *sim, const struct hd_sim_config *config, double period_s) {
    sim->period_s = period_s;
    sim->force_whole_periods = (uint64_t)(config->force_timeout_s / period_s + HD_SAME_TIME);
    const double longest_s = HD_MAX_STEP_PERIODS * period_s;
    sim->limit_s = HD_STEP_MAX / fmax(fastest_rate_per_s(config), HD_STEP_MAX / longest_s);
    sim->lag_limit_s = 0.0;
    if (sim->actuator.order > 0) {
        sim->lag_limit_s = fmin(sim->limit_s, HD_STEP_MAX / sim->actuator.fastest_per_s);
        hd_sim_kernel_at(sim, period_s / fmax(1.0, ceil(period_s / sim->lag_limit_s)), &sim->lagging);
    }
    hd_sim_kernel_at(sim, period_s / fmax(1.0, ceil(period_s / sim->limit_s)), &sim->period);
    sim->stretch_periods = (uint32_t)fmax(1.0, floor(sim->limit_s / period_s));
    hd_sim_kernel_at(sim, sim->stretch_periods * period_s, &sim->stretch);
    /* Rounded down, so that a sample at the end of a period is not one period late. */
    const double interval_s = config->report_interval_s == 0.0 ? period_s : config->report_interval_s;
    const double unit_s = period_s * HD_FRACTION_UNIT;
    sim->sample_interval_s = interval_s;
    sim->sample_interval = (uint64_t)(interval_s / unit_s * (1.0 + 1e-15) + 1e-3);
    sim->sample_delay = (uint64_t)(config->report_delay_s / unit_s * (1.0 + 1e-15) + 1e-3);
    /* Room for one sample that can be read, those under way, and one that is being taken; check_config ensures that
     * they fit. */
    sim->sample_mask = 3u;
    while (sim->sample_mask < sim->sample_delay / sim->sample_interval + 3u) {
        sim->sample_mask = 2u * sim->sample_mask + 1u;
    }
    sim->force_interval = (uint64_t)(config->force_interval_s / unit_s * (1.0 + 1e-15) + 1e-3);
}

struct hd_sim *hd_sim_new(const struct hd_sim_config *config, double period_s) {
    if (check_config(config, period_s) != HD_OK) {
        return NULL;
    }
    struct hd_sim *sim = malloc(sizeof *sim);
    if (sim == NULL) {
        hd_invalid("no memory for a simulated joystick");
        return NULL;
    }
    memset(sim, 0, sizeof *sim);
    sim->mass_kg = config->handle_mass_kg + config->hand_mass_kg;
    sim->damping = config->handle_damping_n_s_per_m;
    sim->hand_damping = config->hand_damping_n_s_per_m;
    sim->stiffness = config->hand_stiffness_n_per_m;
    sim->coulomb_n = config->coulomb_friction_n;
    sim->workspace_m = config->workspace_m;
    sim->encoder_step_m = config->encoder_step_m;
    sim->encoder_per_m = config->encoder_step_m > 0.0 ? 1.0 / config->encoder_step_m : 0.0;
    sim->force_step_n = config->force_step_n;
    sim->force_per_n = config->force_step_n > 0.0 ? 1.0 / config->force_step_n : 0.0;
    sim->force_top = config->force_step_n > 0.0 ? floor(config->max_force_n / config->force_step_n + HD_SAME_TIME)
                                                : config->max_force_n;
    sim->force_timeout_s = config->force_timeout_s;
    make_series(sim);
    hd_actuator_make(&sim->actuator, config, sim->mass_kg, (sim->damping + sim->hand_damping) / sim->mass_kg,
                     sim->stiffness / sim->mass_kg);
    set_period(sim, config, period_s);

    sim->axes[0].x = config->start_m[0];
    sim->axes[1].x = config->start_m[1];
    sim->segment = (struct hd_segment){
        .profile = HD_PROFILE_HOLD,
        .end_s = (double)INFINITY,
        .duration_s = (double)INFINITY,
        .from_m = {config->start_m[0], config->start_m[1]},
    };
    sim->path_announced = true;
    sim->segment_limit_s = sim->limit_s;
    sim->calm_tick = period_s > sim->limit_s ? 0 : UINT64_MAX;
    sim->force_intervals = config->force_intervals;
    restart_samples(sim);
    return sim;
}

int hd_sim_set_period(struct hd_sim *sim, const struct hd_sim_config *config, double period_s) {
    if (check_config(config, period_s) != HD_OK) {
        return HD_ERR_INVALID;
    }
    const double path_s = hd_sim_path_time_s(sim);
    hd_sim_set_force(sim, 0.0, 0.0);
    set_period(sim, config, period_s);
    sim->put_tick = sim->tick;
    sim->put_late_s = 0.0;
    /* The hand's time is continuous to within half a period. path_tick wraps if the path began before the first
     * tick. */
    sim->path_tick = sim->tick - (uint64_t)(int64_t)(path_s / period_s + 0.5);
    sim->segment_limit_s = fmin(sim->segment_limit_s, sim->limit_s);
    /* The rest of this segment is checked period by period; the next segment sets calm_tick again. */
    sim->calm_tick = sim->segment.profile == HD_PROFILE_HOLD && period_s <= sim->segment_limit_s ? UINT64_MAX : 0;
    restart_samples(sim);
    return HD_OK;
}

void hd_sim_hold(struct hd_sim *sim) {
    hd_holders_join(&sim->holders);
}

void hd_sim_free(struct hd_sim *sim) {
    if (sim != NULL && hd_holders_leave(&sim->holders)) {
        free(sim);
    }
}

void hd_sim_operate(struct hd_sim *sim, const struct hd_operator *path) {
    hd_sim_step_operate(sim, path);
}

void hd_sim_settle(struct hd_sim *sim) {
    double reference_m[2];
    hd_sim_reference(sim, reference_m);
    for (int which = 0; which < 2; which++) {
        sim->axes[which].x = fmax(-sim->workspace_m, fmin(sim->workspace_m, reference_m[which]));
        sim->axes[which].v = 0.0;
        sim->off[which] = (struct hd_off){0.0, 0.0};
    }
    restart_samples(sim);
}

void hd_sim_put(struct hd_sim *sim, const double force_n[2]) {
    hd_sim_step_put(sim, force_n);
}

void hd_sim_advance(struct hd_sim *sim, uint32_t periods) {
    hd_sim_step_advance(sim, periods);
}

void hd_sim_read(struct hd_sim *sim, struct hd_reading *reading) {
    hd_sim_step_read(sim, reading);
}

void hd_sim_truth(const struct hd_sim *sim, double position[2], double velocity[2], double force[2]) {
    hd_sim_step_truth(sim, position, velocity, force);
}

int hd_sim_place(struct hd_sim *sim, const double position[2], const double velocity[2]) {
    for (int which = 0; which < 2; which++) {
        if (!(fabs(position[which]) <= sim->workspace_m) || !(fabs(velocity[which]) <= HD_PLACED_MAX_M_PER_S)) {
            return hd_invalid("position[%d]: %g m with a velocity of %g m/s exceeds +-%g m or +-%g m/s", which,
                              position[which], velocity[which], sim->workspace_m, HD_PLACED_MAX_M_PER_S);
        }
    }
    for (int which = 0; which < 2; which++) {
        sim->axes[which] = (struct hd_axis){position[which], velocity[which]};
    }
    return HD_OK;
}

void hd_sim_drive(struct hd_sim *sim, const double *force, size_t count, double *motion) {
    for (size_t i = 0; i < count; i++) {
        for (int which = 0; which < 2; which++) {
            motion[4 * i + (size_t)which] = sim->axes[which].x;
            motion[4 * i + 2u + (size_t)which] = sim->axes[which].v;
        }
        hd_sim_step_put(sim, &force[2 * i]);
        hd_sim_step_advance(sim, 1);
    }
}

size_t hd_sim_size(void) {
    return sizeof(struct hd_sim);
}
