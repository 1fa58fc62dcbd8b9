/* The boundary between the peers and bench/peers.py, which reads this file verbatim, as cffi and gcc do: declarations
 * and `#define NAME number` only, nothing of the core's. Each file includes it once, after <stddef.h> and <stdint.h>.
 *
 * A peer is another way to do what the core does, written so that it does no more and no less; the core's own way is
 * called through the same functions. Functions that say "ns" return the nanoseconds of CLOCK_MONOTONIC that their loop
 * took. SI units. One thread. */

double peer_clock_ns(void);

/* ---- Ringing modes: bench/modes.py ------------------------------------------------------------------------------- */

enum peer_mode_kind {
    PEER_MODE_FLOOR = 0, /* adds up two stored numbers a mode: no synthesis at all */
    PEER_MODE_ROTOR = 1, /* csrc/tick/hd_mode.c */
    PEER_MODE_ROTOR_SINGLE = 2,
    PEER_MODE_LIBM = 3, /* exp, sin and cos at each tick */
    PEER_MODE_RECURRENCE = 4,
    PEER_MODE_RECURRENCE_SINGLE = 5,
    PEER_MODE_TABLE = 6,       /* of sines, the nearest entry */
    PEER_MODE_TABLE_LINEAR = 7 /* interpolated */
};

struct peer_modes; /* opaque */

/* `count` silent modes; `size`: of the table, a power of two. NULL without memory. */
struct peer_modes *peer_modes_new(int kind, size_t count, double period_s, const double *decay_per_s,
                                  const double *omega_rad_per_s, size_t size);
void peer_modes_free(struct peer_modes *modes);
/* A strike with the coefficient `force` [2] that began `before_s` before the tick that was advanced to last. */
void peer_modes_strike(struct peer_modes *modes, size_t mode, const double *force, double before_s);
/* `ticks` ticks; their sums in `out` [ticks][2]. ns */
double peer_modes_run(struct peer_modes *modes, size_t ticks, double *out);
/* The same for mode 0 with `strikes` strikes on the way, at rising ticks `at`, coefficients [strikes][2]; only the last
 * `kept` ticks go to `out`. */
void peer_modes_play(struct peer_modes *modes, size_t ticks, size_t strikes, const uint64_t *at, const double *before_s,
                     const double *force, size_t kept, double *out);

/* ---- Velocity: bench/velocity.py ----------------------------------------------------------------------------------
 */

enum peer_velocity_kind {
    PEER_VELOCITY_OURS = 0, /* csrc/tick/hd_velocity.c */
    PEER_VELOCITY_BACKWARD = 1,
    PEER_VELOCITY_LOW_PASS = 2, /* parameter: its corner, Hz */
    PEER_VELOCITY_LEAST_SQUARES = 3,
    PEER_VELOCITY_FOAW_END = 4,
    PEER_VELOCITY_FOAW_BEST = 5,
    PEER_VELOCITY_KALMAN = 6 /* parameter: jerk, m/s^3 over a square root of Hz */
};

/* Both axes; `parameter`: of a window, its samples. `position` and `velocity` [count][2]. ns */
double peer_velocity(int kind, double parameter, double step_m, size_t count, const double *interval_s,
                     const double *position, double *velocity);
/* Each update of csrc/tick/hd_velocity.c on its own, with the clock's two readings still in it. step_m < 0: only those.
 */
void peer_velocity_each_ns(double step_m, size_t count, const double *interval_s, const double *position, double *ns);

/* ---- Times of events: bench/timing.py -----------------------------------------------------------------------------
 */

enum peer_onset_kind {
    PEER_ONSET_TICK = 0,   /* when the tick sees it */
    PEER_ONSET_LINEAR = 1, /* where the straight line between the two samples crosses */
    PEER_ONSET_SPEED = 2   /* as long ago as the estimated speed needs for the depth */
};

/* `depth` [count][2]: at the sample before (not above 0) and at the tick's; `before_s` [count]: how long before the
 * tick the onset was. ns */
double peer_onset(int kind, size_t count, double period_s, const double *depth, const double *speed, double *before_s);

enum peer_groove_kind {
    PEER_GROOVE_TICK_ONE = 0, /* at the tick, one strike however many were passed */
    PEER_GROOVE_TICK_ALL = 1, /* at the tick, as many strikes as grooves */
    PEER_GROOVE_CROSSING = 2  /* each where the straight line between the two samples crosses it */
};

/* Strikes while passing `along` [count], one position a tick: their times in `time_s` and grooves in `which`, up to
 * `capacity`; *found says how many there were. ns */
double peer_grooves(int kind, size_t count, double period_s, double spacing_m, const double *along, size_t capacity,
                    double *time_s, int64_t *which, size_t *found);

/* ---- Coloured noise: bench/noise.py -------------------------------------------------------------------------------
 */

enum peer_noise_kind {
    PEER_NOISE_WHITE = 0,  /* the white numbers alone */
    PEER_NOISE_DIRECT = 1, /* x[n] = g e[n] - sum a_i x[n-i] */
    PEER_NOISE_LADDER = 2, /* the lattice of two multiplications a stage, not normalised */
    PEER_NOISE_TABLE = 3   /* a stretch that was made before, again and again */
};

#define PEER_NOISE_ORDER 32

/* A filter of each of the `nodes` kinds that `which` [count] picks from: `coefficients` [nodes][order] (a_i; of the
 * ladder k_i) and `gains` [nodes]; of the table `coefficients` [order], its numbers. ns */
double peer_noise(int kind, size_t order, const double *coefficients, const double *gains, size_t count,
                  const uint8_t *which, uint64_t seed, double *out);
/* csrc/tick/hd_noise.c: `noise` is a struct hd_noise. ns */
double peer_noise_lattice(const void *noise, const double *numbers, size_t count, const double *speed,
                          const double *force, double *out);

/* ---- The simulated joystick: bench/joystick.py ---------------------------------------------------------------------
 */

enum peer_joystick_kind {
    PEER_JOYSTICK_EXACT = 0, /* csrc/device/hd_sim_solver.c */
    PEER_JOYSTICK_EULER = 1,
    PEER_JOYSTICK_SEMI_IMPLICIT = 2,
    PEER_JOYSTICK_RK4 = 3
};

struct peer_handle {
    double mass_kg;
    double damping_n_s_per_m;
    double hand_stiffness_n_per_m;
    double hand_damping_n_s_per_m;
    double friction_n;
};

/* Both axes do the same: at rest at 0, the hand's reference follows `waypoints` [points][2] (t_s from 0 on, m),
 * straight between them. `force` [count] is held from tick k to tick k + 1; `position` [count + 1] is of one axis.
 * Returns ns, or -1 where the core refuses the device. */
double peer_joystick(int kind, const struct peer_handle *handle, double period_s, size_t points,
                     const double *waypoints, size_t count, const double *force, double *position);
