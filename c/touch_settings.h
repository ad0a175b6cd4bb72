/* touch_settings.h: chooses the settings of a receiver (touch_settings in touch_receiver.h) for a device and a medium: limits
   of the force, damper in contact, virtual coupling, walls for the proxy. touch_play.h and Python (render/spec.py) call it.
   A caller may change any of them before the first tick. Python has the types of the first two structs from this file
   (c/python/receiver_layout.py); therefore every number of them has eight bytes. */
#ifndef TOUCH_SETTINGS_H
#define TOUCH_SETTINGS_H

#include "touch_effects.h"
#include "touch_slopes.h"

typedef struct { /* what the maker of a device states; 0: not stated, or none */
    double force_max_n, force_continuous_n;
    double torque_max_nm, torque_continuous_nm;
    double delay_s;           /* from a position to the effect of its force, without sampling and hold; 0: 1 ms; -1: none */
    double inertia_kg;        /* 0: that of the smallest desktop devices; -1: none */
    double damping_n_s_per_m, friction_n;
    double resolution_m;      /* a step of the encoder */
} touch_device;

enum { TOUCH_RENDER_AUTO, TOUCH_RENDER_PROXY, TOUCH_RENDER_FIELD }; /* AUTO: a proxy where the field has walls */

#define TOUCH_OF_MEDIUM (-1.0) /* for friction and damping */
#define TOUCH_STABLE (-1.0)    /* for the coupling: the one that the loop can render */

typedef struct { /* options of the renderer; touch_render_defaults has values that are safe for a hand */
    double rate_hz;           /* of the ticks */
    double friction;          /* mu, or TOUCH_OF_MEDIUM */
    double damping_n_s_per_m; /* everywhere, or TOUCH_OF_MEDIUM: the medium's, and in contact the stable value */
    double coupling_n_per_m;  /* 0: none; or TOUCH_STABLE */
    int64_t is_passive;
    double scale;             /* metres of the field for a metre of the device */
    touch_vector clutch_m;    /* point of the field at the device's origin */
    touch_matrix axes;        /* rotates a vector of the device into one of the field */
    double force_scale;
    touch_vector gravity_n;   /* for the weight of the handle, in the device's axes */
    touch_limits force_limits, torque_limits; /* each number that is 0: the device's; slew: to the peak in 5 ms */
    double thermal_s;         /* of the heat that lets the force exceed the continuous limit for a while */
    double ramp_s;            /* in which the force goes to zero when there is no frame, and returns */
    double velocity_cutoff_hz;
    int64_t rendering;        /* TOUCH_RENDER_... */
    double wall_n_per_m;      /* stiffness of the proxy's walls; 0: the field's own */
} touch_render_options;

static inline touch_render_options touch_render_defaults(void) {
    touch_render_options o;
    memset(&o, 0, sizeof o);
    o.rate_hz = 1000.0;
    o.friction = o.damping_n_s_per_m = TOUCH_OF_MEDIUM, o.coupling_n_per_m = TOUCH_STABLE;
    o.scale = o.force_scale = 1.0;
    o.axes.row[0].x = o.axes.row[1].y = o.axes.row[2].z = 1.0;
    o.thermal_s = 1.0, o.ramp_s = 0.02, o.velocity_cutoff_hz = 100.0;
    return o;
}

/* -- limits ----------------------------------------------------------------------------------------------------------- */

#define TOUCH_PEAK_RISE_S 0.005 /* the default slew limit lets the force rise from zero to its peak in this time */
#define TOUCH_DEFAULT_DELAY_S 1e-3
#define TOUCH_MIN_INERTIA_KG 0.045
#define TOUCH_RAMP_MARGIN_S 1.0
#define TOUCH_MAX_RAMP_S 10.0

/* The limits that are wanted, never above those of the device. */
static inline touch_limits touch_limits_of(const touch_limits *wanted, double max, double continuous) {
    touch_limits limits;
    limits.peak = wanted->peak > 0.0 ? touch_fmin(wanted->peak, max) : max;
    if (wanted->continuous > 0.0 && (continuous <= 0.0 || wanted->continuous < continuous)) continuous = wanted->continuous;
    limits.continuous = continuous > 0.0 && continuous < limits.peak ? continuous : 0.0;
    limits.slew_per_s = wanted->slew_per_s > 0.0 ? wanted->slew_per_s : limits.peak / TOUCH_PEAK_RISE_S;
    return limits;
}

/* The longest time that a force may take to go to zero, with a margin, seconds. */
static inline double touch_ramp_limit_s(const touch_limits *limits, double ramp_s) {
    if (!(limits->peak > 0.0)) return 0.0;
    return touch_fmin(TOUCH_RAMP_MARGIN_S + ramp_s + 2.0 * limits->peak / limits->slew_per_s, TOUCH_MAX_RAMP_S);
}

static inline double touch_delay_s(const touch_device *device) {
    return device->delay_s == 0.0 ? TOUCH_DEFAULT_DELAY_S : touch_fmax(device->delay_s, 0.0);
}

static inline double touch_inertia_kg(const touch_device *device) {
    return device->inertia_kg == 0.0 ? TOUCH_MIN_INERTIA_KG : touch_fmax(device->inertia_kg, 0.0);
}

static inline double touch_determinant(const touch_matrix *m) {
    return touch_dot(m->row[0], touch_cross(m->row[1], m->row[2]));
}

/* -- stable stiffness ------------------------------------------------------------------------------------------------- */

/* For slow movements, a force that is sampled, held and delayed by d equals -K x(t - T/2 - d): a spring with a negative
   damper of K (T/2 + d), which the device must compensate (Colgate and Schenkel 1997). In contact the renderer brakes with
   B = 2 K (T/2 + d) - b along the force (touch_braked). The damper lags by L: against a mass m (the device and a light
   hand), B is limited to m / 2L and K to 0.4 m / L^2. One step q of the encoder changes the force by q (K + B / T s), with s
   the weight of a new sample in the velocity filter; this is limited to 35 mN and twice the friction (Diolaiti 2006). A
   stiffer field is rendered through a coupling; but a stiffness that Colgate's rule allows for the bare device is rendered
   to within 8 %. */

#define TOUCH_HAND_KG 0.05
#define TOUCH_SAFETY_FACTOR 2.0
#define TOUCH_MAX_PHASE_SQUARED 0.4       /* (w L)^2, for the oscillation w of hand and wall */
#define TOUCH_MAX_STEP_N 0.035
#define TOUCH_MIN_STIFFNESS_FRACTION 0.92 /* rendered, of a stiffness that Colgate's rule allows */

/* The largest stable stiffness for a field of stiffness k, N/m of the device. */
static inline double touch_max_stiffness(const touch_device *device, const touch_render_options *options, double k,
                                         double lag_s) {
    double tick_s = 1.0 / options->rate_hz, b = device->damping_n_s_per_m;
    double smoothing = -expm1(-2.0 * TOUCH_PI * options->velocity_cutoff_hz * tick_s);
    double damper_lag_s = lag_s + tick_s / 2.0 + tick_s * (1.0 - smoothing) / smoothing;
    double mass = TOUCH_HAND_KG + touch_inertia_kg(device);
    double max_k = touch_fmin((mass / (2.0 * damper_lag_s) + b) / (TOUCH_SAFETY_FACTOR * lag_s),
                              TOUCH_MAX_PHASE_SQUARED * mass / (damper_lag_s * damper_lag_s));
    if (device->resolution_m > 0.0) {
        double by_steps = (TOUCH_MAX_STEP_N + 2.0 * device->friction_n) / device->resolution_m + smoothing * b / tick_s;
        max_k = touch_fmin(max_k, by_steps / (1.0 + smoothing * TOUCH_SAFETY_FACTOR * lag_s / tick_s));
    }
    return touch_fmax(max_k, k * lag_s < b ? TOUCH_MIN_STIFFNESS_FRACTION * k : 0.0);
}

#define TOUCH_STICK_N_PER_M 1000.0 /* of the device: about that of a fingertip along a surface (Nakazawa 2000) */

/* The spring of friction's anchor, as stiff as a hand sticks or as the loop renders stably, and the damper that it needs. The
   damping of the medium is in the settings. */
static inline void touch_choose_stick(touch_settings *settings, const touch_render_options *options,
                                      const touch_device *device) {
    double lag_s = 0.5 / options->rate_hz + touch_delay_s(device), scale = options->scale * options->force_scale;
    double k = touch_fmin(TOUCH_STICK_N_PER_M, touch_max_stiffness(device, options, TOUCH_STICK_N_PER_M, lag_s));
    double c = TOUCH_SAFETY_FACTOR * k * lag_s - device->damping_n_s_per_m - scale * settings->damping_n_s_per_m;
    if (!(scale > 0.0)) return;
    settings->stick_n_per_m = k / scale;
    settings->stick_n_s_per_m = touch_fmax(c, 0.0) / scale;
}

/* Write all settings but those of walls and of the stable damper and coupling, and the state before the first tick. Friction
   and damping are those of the medium. */
static inline void touch_choose_settings(touch_receiver *receiver, const touch_render_options *options,
                                         const touch_device *device, double friction, double damping_n_s_per_m) {
    touch_settings *settings = &receiver->settings;
    memset(settings, 0, sizeof *settings), memset(&receiver->state, 0, sizeof receiver->state);
    memset(&receiver->grip, 0, sizeof receiver->grip);
    settings->rate_hz = options->rate_hz;
    settings->friction = options->friction >= 0.0 ? options->friction : friction;
    settings->damping_n_s_per_m = options->damping_n_s_per_m >= 0.0 ? options->damping_n_s_per_m : damping_n_s_per_m;
    touch_choose_stick(settings, options, device);
    settings->coupling_n_per_m = touch_fmax(options->coupling_n_per_m, 0.0);
    settings->is_passive = options->is_passive;
    settings->scale = options->scale, settings->clutch_m = options->clutch_m, settings->axes = options->axes;
    settings->handedness = touch_determinant(&options->axes) < 0.0 ? -1.0 : 1.0;
    settings->force_scale = options->force_scale, settings->gravity_n = options->gravity_n;
    settings->thermal_s = options->thermal_s, settings->ramp_s = options->ramp_s;
    settings->velocity_cutoff_rad_s = 2.0 * TOUCH_PI * options->velocity_cutoff_hz;
    settings->delay_ticks = touch_fmin(touch_delay_s(device) * options->rate_hz, (double)TOUCH_MAX_DELAY);
    settings->force_limits = touch_limits_of(&options->force_limits, device->force_max_n, device->force_continuous_n);
    if (device->torque_max_nm > 0.0)
        settings->torque_limits =
            touch_limits_of(&options->torque_limits, device->torque_max_nm, device->torque_continuous_nm);
    receiver->state.force.limit = settings->force_limits.peak;
    receiver->state.torque.limit = settings->torque_limits.peak;
    receiver->state.friction = settings->friction;
    receiver->grip.orientation[0] = 1.0;
    double ramp_s = touch_fmax(touch_ramp_limit_s(&settings->force_limits, options->ramp_s),
                               touch_ramp_limit_s(&settings->torque_limits, options->ramp_s));
    receiver->layout.ramp_limit_ns = (int64_t)(1e9 * ramp_s + 0.5);
}

/* -- damper in contact and coupling ----------------------------------------------------------------------------------- */

typedef struct { /* damper in contact and coupling, in units of the field, 0: none; what is rendered, in those of the device */
    double brake_n_s_per_m, coupling_n_per_m;
    double rendered_n_per_m; /* of the medium's largest slope */
    double bare_n_per_m;     /* that the device alone can render */
} touch_stability;

/* The damper in contact and the coupling for a medium with this damping and largest slope. */
static inline touch_stability touch_stability_of(const touch_render_options *options, const touch_device *device,
                                                 double damping_n_s_per_m, double stiffest_n_per_m) {
    touch_stability chosen = {0.0, 0.0, 0.0, 0.0};
    double lag_s = 0.5 / options->rate_hz + touch_delay_s(device), scale = options->scale * options->force_scale;
    double field_k = scale * stiffest_n_per_m, coupling = scale * touch_fmax(options->coupling_n_per_m, 0.0), brake = 0.0;
    if (options->coupling_n_per_m < 0.0 && field_k > 0.0) {
        double max_k = touch_max_stiffness(device, options, field_k, lag_s);
        coupling = field_k > max_k ? field_k * max_k / (field_k - max_k) : 0.0;
    }
    chosen.rendered_n_per_m = field_k;
    if (coupling > 0.0) chosen.rendered_n_per_m = field_k > 0.0 ? 1.0 / (1.0 / field_k + 1.0 / coupling) : 0.0;
    if (options->damping_n_s_per_m < 0.0)
        brake = touch_fmax(0.0, TOUCH_SAFETY_FACTOR * chosen.rendered_n_per_m * lag_s - device->damping_n_s_per_m -
                                    scale * damping_n_s_per_m);
    if (scale > 0.0) chosen.brake_n_s_per_m = brake / scale, chosen.coupling_n_per_m = coupling / scale;
    chosen.bare_n_per_m = device->damping_n_s_per_m / lag_s;
    return chosen;
}

/* Write the damper in contact and the coupling, perhaps while the servo ticks; the ticks approach them slowly. */
static inline void touch_choose_stability(touch_settings *settings, const touch_render_options *options,
                                          const touch_device *device, double damping_n_s_per_m, double stiffest_n_per_m) {
    touch_stability chosen = touch_stability_of(options, device, damping_n_s_per_m, stiffest_n_per_m);
    touch_share_double(&settings->brake_n_s_per_m, chosen.brake_n_s_per_m);
    touch_share_double(&settings->coupling_n_per_m, chosen.coupling_n_per_m);
}

/* -- slopes and walls of a field -------------------------------------------------------------------------------------- */

#define TOUCH_STEEP_FRACTION 1e-3 /* of the resisting cells may be stiffer: edges, corners, noise */

/* The largest slope of a force against its own direction, N/m, of one field; 0: nothing resists. */
static inline double touch_stiffest_n_per_m(const touch_cells *cells, int64_t bricks) {
    int64_t counts[TOUCH_SLOPE_BINS], above = 0, all = 0;
    memset(counts, 0, sizeof counts);
    touch_count_slopes(touch_samples_of(cells), touch_supported_of(cells), bricks, cells->samples_per_m, counts);
    for (int n = 0; n < TOUCH_SLOPE_BINS; n++) all += counts[n];
    for (int n = TOUCH_SLOPE_BINS - 1; n >= 0 && all; n--) {
        above += counts[n];
        if ((double)above > TOUCH_STEEP_FRACTION * (double)all) return pow(2.0, (n + 1.0) / TOUCH_SLOPE_BINS_PER_DOUBLING);
    }
    return 0.0;
}

/* A field is a wall if the force of most samples decreases by K per metre outwards, and is nearly parallel to that of the
   next sample. A constant pull, for example, is not a wall. Samples in the middle of a thin wall, between its two sides, do
   not count. The stiffness is that of the steeper samples, because edges, thin walls and the low-pass decrease it. */

#define TOUCH_WALL_SAMPLES 20000            /* looked at, at most */
#define TOUCH_LARGE_FRACTION 0.98           /* quantile of a "large" force: near the limit, with few samples above */
#define TOUCH_WALL_LOW 0.1                  /* of a large force: samples between the surface */
#define TOUCH_WALL_HIGH 0.85                /* and the limit */
#define TOUCH_WALL_MIN_COSINE 0.8           /* between the forces of a sample and of the point one sample farther out */
#define TOUCH_WALL_MAX_RATIO 0.97           /* between the sizes of these two forces */
#define TOUCH_WALL_MIDDLE_SAMPLES 2         /* behind a sample: a force the other way makes it the middle of a thin wall */
#define TOUCH_WALL_MIN_FRACTION 0.6         /* of the samples must look like a wall */
#define TOUCH_WALL_STIFFNESS_FRACTION 0.75  /* quantile of the slopes that is the wall's stiffness */
#define TOUCH_WALL_MAX_LEVEL_N 0.05
#define TOUCH_WALL_LEVEL_FRACTION 0.1       /* level of the surface, over a large force */

typedef struct { /* stiffness 0: there is no wall; level: force at the surface; a large force of the field */
    double stiffness_n_per_m, level_n, large_n;
} touch_field_wall;

/* Heap sort: nothing is allocated, and the time is bounded. */
static inline void touch_sort_doubles(double *value, int64_t count) {
    for (int64_t start = count / 2, stop = count; stop > 1;) {
        double moved;
        if (start > 0) moved = value[--start];
        else moved = value[--stop], value[stop] = value[0];
        int64_t parent = start, child = 2 * start + 1;
        for (; child < stop; child = 2 * parent + 1) {
            if (child + 1 < stop && value[child + 1] > value[child]) child++;
            if (!(value[child] > moved)) break;
            value[parent] = value[child], parent = child;
        }
        value[parent] = moved;
    }
}

/* The quantile of ascending numbers, linear between two. */
static inline double touch_quantile(const double *value, int64_t count, double fraction) {
    double x = fraction * (double)(count - 1);
    int64_t n = (int64_t)x;
    return n + 1 < count ? value[n] + (x - (double)n) * (value[n + 1] - value[n]) : value[count - 1];
}

static inline touch_vector touch_sample_force(const float *v) { return touch_vector_of(v[0], v[1], v[2]); }

typedef struct { /* samples of a field that a wall's surface may have */
    const touch_field_bricks *field;
    const touch_cells *cells;
    const double *spacing_m, *origin_m;
} touch_wall_field;

typedef enum { TOUCH_NO_WALL, TOUCH_SIDE_OF_WALL, TOUCH_MIDDLE_OF_WALL } touch_wall_part;

/* The force at a point of the field. */
static inline touch_vector touch_wall_force(const touch_wall_field *w, touch_vector point_m) {
    touch_cell_point at = touch_locate(w->cells, point_m);
    return at.corner ? touch_cell_force(at) : touch_zero();
}

/* What part of a wall sample s of a brick is, and the slope of its force outwards there, N/m. */
static inline touch_wall_part touch_wall_part_of(const touch_wall_field *w, uint64_t brick, int s, double *slope_n_per_m) {
    touch_vector force = touch_sample_force(w->field->forces_n + TOUCH_BRICK_FLOATS * brick + 3 * s);
    double size = sqrt(touch_dot(force, force));
    touch_vector outwards = touch_divided(force, size);
    const int32_t *b = w->field->brick + 3 * brick;
    touch_vector way = touch_vector_of(outwards.x * w->spacing_m[0], outwards.y * w->spacing_m[1],
                                       outwards.z * w->spacing_m[2]);
    double step_m = sqrt(touch_dot(way, way));
    touch_vector point = touch_vector_of(w->origin_m[0] + w->spacing_m[0] * (8.0 * b[0] + (s >> 6)),
                                         w->origin_m[1] + w->spacing_m[1] * (8.0 * b[1] + (s >> 3 & 7)),
                                         w->origin_m[2] + w->spacing_m[2] * (8.0 * b[2] + (s & 7)));
    touch_vector outer = touch_wall_force(w, touch_add_scaled(point, step_m, outwards));
    double outer_size = sqrt(touch_dot(outer, outer));
    if (touch_dot(outer, outwards) >= TOUCH_WALL_MIN_COSINE * outer_size && outer_size < TOUCH_WALL_MAX_RATIO * size) {
        *slope_n_per_m = (size - outer_size) / step_m;
        return TOUCH_SIDE_OF_WALL;
    }
    for (int n = 1; n <= TOUCH_WALL_MIDDLE_SAMPLES; n++) {
        touch_vector behind = touch_wall_force(w, touch_add_scaled(point, -n * step_m, outwards));
        if (touch_dot(behind, outwards) < 0.0) return TOUCH_MIDDLE_OF_WALL; /* the other side pushes the other way */
    }
    return TOUCH_NO_WALL;
}

/* The sizes of all forces of a field that are not zero; `out` NULL: only their number. */
static inline int64_t touch_force_sizes(const touch_field_bricks *field, double *out) {
    int64_t count = 0;
    for (uint64_t n = 0; n < 512 * field->bricks; n++) {
        if (!touch_has_force(field->forces_n + 3 * n)) continue;
        touch_vector force = touch_sample_force(field->forces_n + 3 * n);
        if (out) out[count] = sqrt(touch_dot(force, force));
        count++;
    }
    return count;
}

/* Whether a sample lies on the ramp between surface and limit. */
static inline int touch_is_on_ramp(const float *force_n, double large_n) {
    touch_vector force = touch_sample_force(force_n);
    double size = sqrt(touch_dot(force, force));
    return size > TOUCH_WALL_LOW * large_n && size < TOUCH_WALL_HIGH * large_n;
}

/* The wall in a field. `work` has room for touch_force_sizes(field, NULL) numbers. */
static inline touch_field_wall touch_find_wall(const touch_wall_field *w, double *work) {
    touch_field_wall wall = {0.0, 0.0, 0.0};
    const touch_field_bricks *field = w->field;
    int64_t count = touch_force_sizes(field, work), on_ramp = 0, seen = 0, looked_at = 0, walls = 0;
    if (!count) return wall;
    touch_sort_doubles(work, count);
    double large_n = touch_quantile(work, count, TOUCH_LARGE_FRACTION);
    for (uint64_t n = 0; n < 512 * field->bricks; n++) on_ramp += touch_is_on_ramp(field->forces_n + 3 * n, large_n);
    int64_t every = (on_ramp + TOUCH_WALL_SAMPLES - 1) / TOUCH_WALL_SAMPLES;
    for (uint64_t n = 0; n < 512 * field->bricks; n++) {
        if (!touch_is_on_ramp(field->forces_n + 3 * n, large_n) || seen++ % every) continue;
        double slope = 0.0;
        touch_wall_part part = touch_wall_part_of(w, n >> 9, (int)(n & 511), &slope);
        if (part != TOUCH_MIDDLE_OF_WALL) looked_at++;
        if (part == TOUCH_SIDE_OF_WALL) work[walls++] = slope;
    }
    if (!looked_at || (double)walls < TOUCH_WALL_MIN_FRACTION * (double)looked_at) return wall;
    touch_sort_doubles(work, walls);
    wall.stiffness_n_per_m = touch_quantile(work, walls, TOUCH_WALL_STIFFNESS_FRACTION);
    wall.level_n = touch_fmin(TOUCH_WALL_MAX_LEVEL_N, TOUCH_WALL_LEVEL_FRACTION * large_n);
    wall.large_n = large_n;
    return wall;
}

#endif
