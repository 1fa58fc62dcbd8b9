/* Noise: against the direct form of the same filter, its power while its coefficients stand still and while they jump,
 * what the grid and a ramp do to them, and every fault that the check refuses. */
#include <math.h>
#include <string.h>

#include "base/hd_gaussian.h"
#include "hd_test.h"
#include "scene/hd_world.h"
#include "tick/hd_noise.h"

enum { ORDER = HD_NOISE_ORDER, NODE = 2 * ORDER + 2, NUMBERS = 64 * NODE };

/* A noise with the numbers it refers to, which begin at 3 so that `first` matters. */
struct model {
    struct hd_noise noise;
    double numbers[NUMBERS];
    uint32_t count;
};

/* From -1 to 1. */
static double anywhere(uint64_t *seed) {
    return (double)(test_random(seed) >> 11) * 0x1p-52 - 1.0;
}

static void put(struct model *model, double number) {
    CHECK(model->count < NUMBERS);
    model->numbers[model->count++] = number;
}

static void begin(struct model *model, uint32_t order, uint32_t taps, uint32_t speeds, uint32_t forces) {
    memset(model, 0, sizeof *model);
    model->noise = (struct hd_noise){
        .order = order,
        .taps = taps,
        .speed_count = speeds,
        .force_count = forces,
        .first = 3,
        .seed = 11,
        .force_per_unit = 1.0,
    };
    model->count = 3;
    for (uint32_t i = 0; i < speeds; i++)
        put(model, 0.1 * (i + 1));
    for (uint32_t i = 0; i < forces; i++)
        put(model, 0.5 * (i + 1));
}

/* One node: coefficients up to `reach`, an RMS, random taps. */
static void put_node(struct model *model, double rms, double reach, uint64_t *seed) {
    double tap[ORDER + 1];
    double squares = 0.0;

    put(model, rms);
    for (uint32_t m = 0; m < model->noise.order; m++)
        put(model, reach * anywhere(seed));
    for (uint32_t m = 0; model->noise.taps && m <= model->noise.order; m++) {
        tap[m] = anywhere(seed);
        squares += tap[m] * tap[m];
    }
    for (uint32_t m = 0; model->noise.taps && m <= model->noise.order; m++)
        put(model, tap[m] / sqrt(squares));
}

/* A single node of RMS 1. */
static void make(struct model *model, uint32_t order, uint32_t taps, double reach, uint64_t *seed) {
    begin(model, order, taps, 1, 1);
    put_node(model, 1.0, reach, seed);
    CHECK(hd_noise_check(&model->noise, model->numbers, model->count, "noise") == HD_OK);
}

static double next(struct hd_active_noise *active, const struct model *model, double ramp_step) {
    return hd_noise_next(active, &model->noise, model->numbers, 0.1, 0.5, ramp_step);
}

/* Step-up recursion: the polynomial A_m from A_(m-1), a_i += k a_(m-i). */
static void step_up(double *a, uint32_t m, double k) {
    double before[ORDER + 2];

    memcpy(before, a, sizeof before);
    before[m] = 0.0;
    for (uint32_t i = 0; i <= m; i++)
        a[i] = before[i] + k * before[m - i];
}

/* The same filter as a ratio of polynomials, fed with the same white numbers, from rest. b_m is A_m reversed, over
 * A_order, times the cosines of the stages above m. */
static void follows_the_direct_form(uint32_t order, uint32_t taps, uint64_t *seed) {
    struct model model;
    struct hd_active_noise active;
    double a[ORDER + 2] = {1.0};
    double numerator[ORDER + 2] = {0.0};
    double white[ORDER + 1] = {0.0};
    double output[ORDER + 1] = {0.0};
    uint64_t random;

    make(&model, order, taps, 0.6, seed);
    const double *sine = model.numbers + 6;
    for (uint32_t m = 0; m <= order; m++) {
        double gain = taps ? sine[order + m] : m == 0 ? 1.0 : 0.0;

        if (m > 0)
            step_up(a, m, sine[m - 1]);
        for (uint32_t above = m; above < order; above++)
            gain *= sqrt(1.0 - sine[above] * sine[above]);
        for (uint32_t i = 0; i <= m; i++)
            numerator[i] += gain * a[m - i];
    }
    hd_noise_start(&active, &model.noise, model.numbers, 5);
    memset(active.delay, 0, sizeof active.delay);
    random = active.random;
    for (int n = 0; n < 2000; n++) {
        double sum = 0.0;

        memmove(white + 1, white, order * sizeof white[0]);
        memmove(output + 1, output, order * sizeof output[0]);
        white[0] = hd_gaussian(test_random(&random));
        for (uint32_t i = 0; i <= order; i++)
            sum += numerator[i] * white[i] - (i > 0 ? a[i] * output[i] : 0.0);
        output[0] = sum;
        CHECK(fabs(next(&active, &model, 1.0) - sum) < 1e-10);
    }
}

/* Every quantile, by the C library's erfc, which is the two-sided tail U; both signs, to the bound and not beyond. */
static void is_gaussian(uint64_t *seed) {
    double squares = 0.0;
    double fourth = 0.0;
    const int count = 1000000;

    for (int n = 0; n < count; n++) {
        const uint64_t bits = test_random(seed);
        const uint64_t small = bits >> test_below(seed, 40) | (bits & 1u);
        const double tail = (double)(small & ~(uint64_t)1) * 0x1p-64;
        const double z = hd_gaussian(small);
        const double number = hd_gaussian(bits);

        CHECK(fabs(z) <= 6.0 && (z < 0.0) == (small & 1u));
        if (fabs(z) < 5.97)
            CHECK(erfc((fabs(z) + 3e-6) / sqrt(2.0)) <= tail && tail <= erfc((fabs(z) - 3e-6) / sqrt(2.0)));
        else
            CHECK(tail <= erfc(5.969 / sqrt(2.0)));
        squares += number * number;
        fourth += number * number * number * number;
    }
    CHECK(hd_gaussian(0) == 6.0 && hd_gaussian(1) == -6.0 && fabs(hd_gaussian(UINT64_MAX)) < 1e-6);
    /* Five standard errors. */
    CHECK(fabs(squares / count - 1.0) < 5.0 * sqrt(2.0 / count));
    CHECK(fabs(fourth / count - 3.0) < 5.0 * sqrt(96.0 / count));
}

/* The standard error of the power is below sqrt(2 / (count / memory)), with a memory of a few samples here. */
static void has_unit_power(uint32_t order, uint32_t taps, double reach, uint64_t *seed) {
    const int count = 200000;
    struct model model;
    struct hd_active_noise active;
    double sum = 0.0;
    double squares = 0.0;

    make(&model, order, taps, reach, seed);
    hd_noise_start(&active, &model.noise, model.numbers, 0);
    for (int n = 0; n < count; n++) {
        double sample = next(&active, &model, 1.0);

        sum += sample;
        squares += sample * sample;
    }
    CHECK(fabs(squares / count - 1.0) < 0.05);
    CHECK(fabs(sum / count) < 0.05);
}

/* Every 20 samples from one model to the other, at once or over the 20. An output is a sum of bounded numbers with unit
 * coefficients: one in 10^8 would be beyond 6 at the most. */
static void stays_bounded_when_swung(int pairs, uint64_t *seed) {
    struct hd_active_noise active;
    double squares = 0.0;
    int count = 0;

    for (int pair = 0; pair < pairs; pair++) {
        struct model models[2];
        double ramp_step = pair % 2 ? 1.0 : 0.05;

        for (int i = 0; i < 2; i++) {
            const uint32_t order = (uint32_t)test_below(seed, ORDER + 1);
            const uint32_t taps = (uint32_t)test_below(seed, 2);

            make(&models[i], order, taps, pair % 3 ? 1.0 : 0.3, seed);
        }
        hd_noise_start(&active, &models[0].noise, models[0].numbers, (uint32_t)pair);
        for (int n = 0; n < 600; n++) {
            double sample;

            if (n % 20 == 0)
                hd_noise_turn(&active);
            sample = next(&active, &models[n / 20 % 2], ramp_step);
            CHECK(fabs(sample) < 6.0);
            squares += sample * sample;
            count++;
        }
    }
    CHECK(fabs(squares / count - 1.0) < 0.05);
}

/* Many noises that go through the same ramps, also to other orders and back: delays stay uncorrelated and of unit
 * power. Each entry's standard error is at most sqrt(2 / noises). */
static void keeps_the_covariance(int ticks, uint64_t *seed) {
    enum { SIZE = 10 };
    const uint32_t noises = 20000;
    double sums[SIZE][SIZE] = {{0.0}};
    struct model models[4];
    struct hd_active_noise active;
    const double limit = 6.0 * sqrt(2.0 / noises);

    make(&models[0], 4, 0, 0.95, seed);
    make(&models[1], SIZE, 1, 0.95, seed);
    make(&models[2], 1, 0, 0.95, seed);
    make(&models[3], 7, 0, 0.95, seed);
    for (uint32_t salt = 0; salt < noises; salt++) {
        memset(&active, 0, sizeof active);
        hd_noise_start(&active, &models[0].noise, models[0].numbers, salt);
        for (int n = 0; n < ticks; n++) {
            if (n % 6 == 5)
                hd_noise_turn(&active);
            next(&active, &models[(n + 1) / 6 % 4], 0.2);
        }
        for (int i = 0; i < SIZE; i++)
            for (int j = 0; j <= i; j++)
                sums[i][j] += active.delay[i] * active.delay[j];
    }
    for (int i = 0; i < SIZE; i++)
        for (int j = 0; j <= i; j++)
            CHECK(fabs(sums[i][j] / noises - (i == j ? 1.0 : 0.0)) < limit);
}

static void repeats_itself(uint64_t *seed) {
    struct model model;
    struct hd_active_noise noises[3];
    int same = 0;

    make(&model, 10, 1, 0.9, seed);
    hd_noise_start(&noises[0], &model.noise, model.numbers, 8);
    hd_noise_start(&noises[1], &model.noise, model.numbers, 8);
    hd_noise_start(&noises[2], &model.noise, model.numbers, 9);
    for (int n = 0; n < 1000; n++) {
        double sample = next(&noises[0], &model, 1.0);

        CHECK(next(&noises[1], &model, 1.0) == sample);
        same += next(&noises[2], &model, 1.0) == sample;
    }
    CHECK(same == 0);
}

/* The noise that rests now and then gives, in all, the samples of the one that never does. A turn waits, too. */
static void rests_and_continues(uint64_t *seed) {
    struct model model;
    struct hd_active_noise busy;
    struct hd_active_noise lazy;
    struct hd_active_noise before;

    make(&model, 5, 0, 0.9, seed);
    model.noise.threshold_m_per_s = 0.05;
    hd_noise_start(&busy, &model.noise, model.numbers, 0);
    hd_noise_start(&lazy, &model.noise, model.numbers, 0);
    for (int n = 0; n < 500; n++) {
        for (int rest = n % 3; rest > 0; rest--) {
            before = lazy;
            CHECK(hd_noise_next(&lazy, &model.noise, model.numbers, 0.0, 0.5, 0.1) == 0.0);
            CHECK(lazy.random == before.random && lazy.blend == before.blend);
            CHECK(memcmp(lazy.delay, before.delay, model.noise.order * sizeof lazy.delay[0]) == 0);
            CHECK(memcmp(lazy.sine, before.sine, model.noise.order * sizeof lazy.sine[0]) == 0);
        }
        CHECK(next(&lazy, &model, 0.1) == next(&busy, &model, 0.1));
        if (n % 50 == 20) {
            hd_noise_turn(&busy);
            hd_noise_turn(&lazy);
        }
    }
    model.noise.threshold_m_per_s = 0.0;
    CHECK(hd_noise_next(&lazy, &model.noise, model.numbers, 0.0, 0.5, 0.1) == 0.0);
    CHECK(hd_noise_next(&lazy, &model.noise, model.numbers, 1e-300, 0.5, 0.1) != 0.0);
    CHECK(hd_noise_next(&lazy, &model.noise, model.numbers, (double)NAN, 0.5, 0.1) == 0.0);
    CHECK(hd_noise_next(&lazy, &model.noise, model.numbers, 0.1, (double)NAN, 0.1) == 0.0);
}

/* rms(v, F), as the ratio to the same noise with an RMS of 1. */
static void keeps_the_law(uint64_t *seed) {
    struct model unit;
    struct model model;

    make(&unit, 3, 1, 0.5, seed);
    model = unit;
    model.numbers[5] = 0.5;
    model.noise.velocity_gain_per_s = 20.0;
    model.noise.force_gain_m_per_s2_per_n = -3.0;
    model.noise.threshold_m_per_s = 0.04;
    CHECK(hd_noise_check(&model.noise, model.numbers, model.count, "noise") == HD_OK);
    for (int n = 0; n < 2000; n++) {
        double speed = 0.2 * anywhere(seed);
        double force = 1.0 + anywhere(seed);
        double rms = fmax(0.0, 20.0 * fabs(speed) - 3.0 * force + 0.5) * fmin(1.0, fabs(speed) / 0.04);
        double sample;
        double reference = 0.0;

        CHECK(hd_noise_run(&unit.noise, unit.numbers, unit.count, 1, &(double){0.1}, &force, &reference) == HD_OK);
        CHECK(hd_noise_run(&model.noise, model.numbers, model.count, 1, &speed, &force, &sample) == HD_OK);
        CHECK(fabs(sample - rms * reference) <= 1e-14 * fabs(rms * reference));
    }
}

/* The place on an axis by brute force: the cell, and how far into it. */
static double place_on(const double *axis, uint32_t count, double x, uint32_t *cell) {
    *cell = 0;
    if (count == 1 || x <= axis[0])
        return 0.0;
    while (*cell + 2 < count && x >= axis[*cell + 1])
        ++*cell;
    return fmin(1.0, (x - axis[*cell]) / (axis[*cell + 1] - axis[*cell]));
}

static void follows_the_grid(uint32_t speeds, uint32_t forces, uint64_t *seed) {
    const uint32_t order = 4;
    const uint32_t size = 2 * order + 2;
    struct model model;
    struct hd_active_noise active;

    begin(&model, order, 1, speeds, forces);
    for (uint32_t i = 0; i < speeds * forces; i++)
        put_node(&model, 1.0 + anywhere(seed), 0.95, seed);
    CHECK(hd_noise_check(&model.noise, model.numbers, model.count, "noise") == HD_OK);
    hd_noise_start(&active, &model.noise, model.numbers, 1);
    for (uint32_t n = 0; n < 2000; n++) {
        /* Nodes themselves, too, and beyond the ends. */
        const double speed = n % 5 ? 0.06 * speeds * (1.0 + anywhere(seed)) + 0.01 : 0.1 * (double)(1 + n / 5 % speeds);
        const double force = n % 7 ? 0.30 * forces * (1.0 + anywhere(seed)) : 0.5 * (double)(1 + n / 7 % forces);
        const double *nodes = model.numbers + 3 + speeds + forces;
        double expected[NODE] = {0.0};
        double squares = 0.0;
        uint32_t cell[2];
        const double i = place_on(model.numbers + 3, speeds, speed, &cell[0]);
        const double j = place_on(model.numbers + 3 + speeds, forces, force, &cell[1]);

        for (uint32_t corner = 0; corner < 4; corner++) {
            const uint32_t row = cell[0] + (corner & 1u);
            const uint32_t column = cell[1] + (corner >> 1u);
            const double weight = (corner & 1u ? i : 1.0 - i) * (corner >> 1u ? j : 1.0 - j);

            for (uint32_t m = 0; m < size && weight > 0.0; m++)
                expected[m] += weight * nodes[(row * forces + column) * size + m];
        }
        for (uint32_t m = order + 1; m < size; m++)
            squares += expected[m] * expected[m];
        hd_noise_next(&active, &model.noise, model.numbers, n % 2 ? speed : -speed, force, 1.0);
        CHECK(fabs(active.level - expected[0]) < 1e-13);
        for (uint32_t m = 0; m < order; m++) {
            CHECK(fabs(active.sine[m] - expected[m + 1]) < 1e-13);
            CHECK(fabs(active.sine[m] * active.sine[m] + active.cosine[m] * active.cosine[m] - 1.0) < 1e-15);
        }
        for (uint32_t m = 0; m <= order; m++)
            CHECK(fabs(active.tap[m] - expected[order + 1 + m] / sqrt(fmax(squares, 0.01))) < 1e-12);
    }
}

/* What a node's tap is; without taps, all of b_0. */
static double tap_of(const struct model *model, uint32_t m) {
    if (!model->noise.taps)
        return m == 0 ? 1.0 : 0.0;
    return m <= model->noise.order ? model->numbers[6 + model->noise.order + m] : 0.0;
}

/* There, back and there again: what was left behind by the first way must not come back. */
static void turns_over_the_ramp(uint64_t *seed) {
    struct model models[2];
    struct hd_active_noise active;

    make(&models[0], 3, 0, 0.9, seed);
    make(&models[1], 7, 1, 0.9, seed);
    models[1].numbers[5] = 5.0;
    hd_noise_start(&active, &models[0].noise, models[0].numbers, 2);
    next(&active, &models[0], 0.125);
    for (int way = 0; way < 3; way++) {
        const struct model *old = &models[way % 2];
        const struct model *new = &models[1 - way % 2];
        const struct hd_active_noise before = active;

        hd_noise_turn(&active);
        CHECK(memcmp(active.delay, before.delay, sizeof active.delay) == 0);
        for (int n = 1; n <= 10; n++) {
            const double blend = n < 8 ? 0.125 * n : 1.0;
            double expected[ORDER + 1];
            double squares = 0.0;

            CHECK(isfinite(next(&active, new, 0.125)));
            CHECK(active.order == (n < 8 ? 7 : new->noise.order));
            CHECK(active.taps == (n < 8 || new->noise.taps ? 1 : 0));
            CHECK(fabs(active.level - ((1.0 - blend) * old->numbers[5] + blend * new->numbers[5])) < 1e-13);
            for (uint32_t m = 0; m < active.order; m++) {
                const double from = m < old->noise.order ? old->numbers[6 + m] : 0.0;
                const double to = m < new->noise.order ? new->numbers[6 + m] : 0.0;

                CHECK(fabs(active.sine[m] - ((1.0 - blend) * from + blend * to)) < 1e-14);
            }
            for (uint32_t m = 0; m <= active.order; m++) {
                expected[m] = (1.0 - blend) * tap_of(old, m) + blend * tap_of(new, m);
                squares += expected[m] * expected[m];
            }
            for (uint32_t m = 0; active.taps && m <= active.order; m++)
                CHECK(fabs(active.tap[m] - expected[m] / sqrt(squares)) < 1e-14);
        }
        CHECK(memcmp(active.sine, new->numbers + 6, new->noise.order * sizeof active.sine[0]) == 0);
    }
}

/* To itself, a turn changes nothing; on the way to its opposite, the noise goes through silence, not to infinity. */
static void turns_to_itself_and_over(uint64_t *seed) {
    struct model model;
    struct model opposite;
    struct hd_active_noise plain;
    struct hd_active_noise turned;

    make(&model, 6, 0, 0.9, seed);
    hd_noise_start(&plain, &model.noise, model.numbers, 0);
    turned = plain;
    for (int n = 0; n < 300; n++) {
        if (n % 7 == 3)
            hd_noise_turn(&turned);
        CHECK(next(&plain, &model, 0.3) == next(&turned, &model, 0.3));
    }
    make(&model, 4, 1, 0.9, seed);
    opposite = model;
    for (uint32_t m = 0; m <= 4; m++)
        opposite.numbers[10 + m] = -model.numbers[10 + m];
    hd_noise_start(&turned, &model.noise, model.numbers, 0);
    hd_noise_turn(&turned);
    for (int n = 1; n <= 64; n++) {
        const double sample = next(&turned, &opposite, 1.0 / 64.0);

        CHECK(n == 32 ? fabs(sample) < 1e-13 : isfinite(sample) && sample != 0.0);
    }
}

/* sqrt(1 - k^2) of any k, as k = 1 - e, in a form that cannot cancel. */
static void has_exact_cosines(uint64_t *seed) {
    struct model model;
    struct hd_active_noise active;

    make(&model, 1, 0, 0.5, seed);
    for (int n = 0; n < 1000; n++) {
        const double k = 1.0 - pow(10.0, -8.0 + 8.0 * anywhere(seed)) / 1.1;
        const double e = 1.0 - fabs(k);

        if (fabs(k) < 1.0) {
            model.numbers[6] = n % 2 ? k : -k;
            hd_noise_start(&active, &model.noise, model.numbers, 0);
            CHECK(fabs(active.cosine[0] - sqrt(2.0 * e - e * e)) <= 4e-16 * active.cosine[0]);
        }
    }
}

/* Coefficients a rounding error from 1 and from -1, and every number between two of them. */
static void bears_the_edge(uint64_t *seed) {
    const double edge = 1.0 - 0x1p-53;
    struct model model;
    struct hd_active_noise active;

    begin(&model, 2, 0, 2, 2);
    for (int i = 0; i < 4; i++) {
        put(&model, 1.0);
        put(&model, i % 2 ? edge : -edge);
        put(&model, i < 2 ? edge : 1.0 - 0x1p-52 * (double)test_below(seed, 8) - 0x1p-53);
    }
    CHECK(hd_noise_check(&model.noise, model.numbers, model.count, "noise") == HD_OK);
    hd_noise_start(&active, &model.noise, model.numbers, 0);
    for (int n = 0; n < 200000; n++) {
        const double speed = n % 3 ? 0.15 + 0.05 * anywhere(seed) : 0.2 - 0x1p-55 * (double)test_below(seed, 4);
        const double force = n % 2 ? 0.75 + 0.25 * anywhere(seed) : 1.0 - 0x1p-53 * (double)test_below(seed, 4);

        CHECK(fabs(hd_noise_next(&active, &model.noise, model.numbers, speed, force, 1.0)) < 6.0);
        for (int m = 0; m < 2; m++)
            CHECK(fabs(active.sine[m]) <= 1.0 && active.cosine[m] >= 0.0);
    }
}

static void refuse(const struct model *model, const char *word) {
    double out = 7.0;

    CHECK(hd_noise_check(&model->noise, model->numbers, model->count, "noise 5") == HD_ERR_INVALID);
    CHECK(strncmp(hd_invalid_reason(), "noise 5: ", 9) == 0 && strstr(hd_invalid_reason(), word) != NULL);
    CHECK(strchr(hd_invalid_reason(), '\n') == NULL);
    CHECK(hd_noise_run(&model->noise, model->numbers, model->count, 1, &(double){0.1}, &(double){0.1}, &out) ==
          HD_ERR_INVALID);
    CHECK(out == 7.0);
}

#define REFUSE(where, value, word)   \
    do {                             \
        struct model broken = sound; \
        broken.where = (value);      \
        refuse(&broken, word);       \
    } while (0)

static void refuses_every_fault(uint64_t *seed) {
    static const double inside[] = {0.0, 1e-300, 1e9};
    static const double never[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
    struct model sound;
    double out = 7.0;

    begin(&sound, 3, 1, 2, 3);
    for (int i = 0; i < 6; i++)
        put_node(&sound, inside[i % 3], 0.9, seed);
    CHECK(hd_noise_check(&sound.noise, sound.numbers, sound.count, "noise 5") == HD_OK);

    REFUSE(noise.order, HD_NOISE_ORDER + 1, "order 33");
    REFUSE(noise.order, UINT32_MAX, "order");
    REFUSE(noise.taps, 2, "taps 2");
    REFUSE(noise.along_normal, 2, "along_normal 2");
    REFUSE(noise.speed_count, 0, "0 speeds");
    REFUSE(noise.force_count, 0, "0 forces");
    REFUSE(noise.speed_count, UINT32_MAX, "do not fit");
    REFUSE(noise.force_count, UINT32_MAX, "do not fit");
    REFUSE(noise.first, 4, "do not fit");
    REFUSE(noise.first, UINT32_MAX, "do not fit");
    REFUSE(count, sound.count - 1, "do not fit");
    REFUSE(count, 0, "do not fit");
    {
        /* Products and sums that come out small in 32 bits, and in 64. */
        struct model broken = sound;

        broken.noise.speed_count = broken.noise.force_count = 65536;
        refuse(&broken, "do not fit");
        broken.noise.speed_count = broken.noise.force_count = broken.noise.first = UINT32_MAX;
        refuse(&broken, "do not fit");
        broken.noise = sound.noise;
        broken.noise.order = 31;
        broken.noise.taps = 0;
        broken.noise.speed_count = 1u << 31;
        broken.noise.force_count = 1u << 28; /* 2^64 numbers */
        broken.count = UINT32_MAX;
        refuse(&broken, "do not fit");
    }
    for (int i = 0; i < 3; i++) {
        REFUSE(noise.threshold_m_per_s, never[i], "threshold");
        REFUSE(noise.force_per_unit, never[i], "force per unit");
        REFUSE(noise.velocity_gain_per_s, never[i], "velocity gain");
        REFUSE(noise.force_gain_m_per_s2_per_n, never[i], "force gain");
        for (int at = 3; at < 5; at++)
            REFUSE(numbers[at], never[i], "speeds");
        for (int at = 5; at < 8; at++)
            REFUSE(numbers[at], never[i], "forces");
        for (uint32_t node = 0; node < 6; node++) {
            REFUSE(numbers[8 + 8 * node], never[i], "RMS");
            for (uint32_t m = 1; m <= 3; m++)
                REFUSE(numbers[8 + 8 * node + m], never[i], "reflection");
            for (uint32_t m = 4; m <= 7; m++)
                REFUSE(numbers[8 + 8 * node + m], never[i], "taps");
        }
    }
    REFUSE(noise.threshold_m_per_s, -1e-9, "threshold");
    REFUSE(noise.force_per_unit, -1e-9, "force per unit");
    REFUSE(numbers[3], -1e-9, "speeds");
    REFUSE(numbers[3], sound.numbers[4], "speeds");
    REFUSE(numbers[5], -1e-9, "forces");
    REFUSE(numbers[6], sound.numbers[7], "forces");
    REFUSE(numbers[8], -1e-9, "RMS");
    REFUSE(numbers[8], 1.000001e9, "RMS");
    REFUSE(numbers[9], 1.0, "coefficient 1 of node 0");
    REFUSE(numbers[9], -1.0, "coefficient 1 of node 0");
    REFUSE(numbers[8 + 8 * 5 + 3], 1.0, "coefficient 3 of node 5");
    REFUSE(numbers[12], sound.numbers[12] + 1e-6, "taps of node 0");
    CHECK(hd_noise_run(&sound.noise, sound.numbers, sound.count, 1, &never[0], inside, &out) == HD_ERR_INVALID);
    CHECK(hd_noise_run(&sound.noise, sound.numbers, sound.count, 1, inside, &never[1], &out) == HD_ERR_INVALID);
    CHECK(strstr(hd_invalid_reason(), "entry 0") != NULL && out == 7.0);
    CHECK(hd_noise_run(&sound.noise, sound.numbers, sound.count, 0, NULL, NULL, NULL) == HD_OK);
}

int main(void) {
    uint64_t seed = 1;

    for (uint32_t order = 0; order <= ORDER; order++)
        for (uint32_t taps = 0; taps < 2; taps++)
            follows_the_direct_form(order, taps, &seed);
    for (uint32_t taps = 0; taps < 2; taps++) {
        has_unit_power(0, taps, 0.0, &seed);
        has_unit_power(1, taps, 0.9, &seed);
        has_unit_power(2, taps, 0.8, &seed);
        has_unit_power(10, taps, 0.5, &seed);
        has_unit_power(ORDER, taps, 0.3, &seed);
    }
    is_gaussian(&seed);
    stays_bounded_when_swung(1000, &seed);
    keeps_the_covariance(6, &seed);
    keeps_the_covariance(47, &seed);
    repeats_itself(&seed);
    rests_and_continues(&seed);
    keeps_the_law(&seed);
    follows_the_grid(1, 1, &seed);
    follows_the_grid(2, 1, &seed);
    follows_the_grid(1, 5, &seed);
    follows_the_grid(7, 4, &seed);
    turns_over_the_ramp(&seed);
    turns_to_itself_and_over(&seed);
    has_exact_cosines(&seed);
    bears_the_edge(&seed);
    refuses_every_fault(&seed);
    printf("test_noise: ok\n");
    return 0;
}
