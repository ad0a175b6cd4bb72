/* touch_effects.h: what the renderer adds to the force of a field, and the limits that every force passes last, in the order
   of a tick, where passivity has two halves, one at each end:

       velocity                 of the hand in the field, low-passed (after the passivity observer)
       virtual coupling         a spring K between the hand and a proxy in the field (Colgate, Stanley and Brown 1995)
       damping                  a damper along the force of contact
       vibration, materials     sines along the force: of the medium, and textures and stick-slip of materials
       passivity                observer and controller in the time domain (Hannaford and Ryu 2002)
       limits                   peak, continuous force by heat, and slew rate

   The force F of the field is that on the hand, outwards from a surface. Forces and velocities are in the field's axes up
   to materials, and in the device's from passivity on. */
#ifndef TOUCH_EFFECTS_H
#define TOUCH_EFFECTS_H

#include "touch_query.h"
#include "touch_shared.h"

#include <stddef.h>

/* -- time ------------------------------------------------------------------------------------------------------------- */

/* A tick that comes later than this many periods may move the force no further than one that comes now: no leap after a
   stall. */
#define TOUCH_MAX_LATE_PERIODS 2.0

/* True if dt is a time in which something may change; in a receiver without settings nothing does. */
static inline int touch_is_time_step(const touch_settings *settings, double dt_s) {
    return dt_s > 0.0 && dt_s < HUGE_VAL && settings->rate_hz > 0.0;
}

/* The time for which forces and gains may move, s. */
static inline double touch_clamped_dt(const touch_settings *settings, double dt_s) {
    return touch_fmin(dt_s, TOUCH_MAX_LATE_PERIODS / settings->rate_hz);
}

/* -- velocity --------------------------------------------------------------------------------------------------------- */

/* Update the velocity in the field, a low-pass of first order, after a displacement in `since_s` seconds. */
static inline void touch_update_velocity(touch_receiver *receiver, touch_vector displacement_m, double since_s) {
    touch_tick_state *state = &receiver->state;
    double weight = -expm1(-receiver->settings.velocity_cutoff_rad_s * since_s);
    touch_vector before = touch_scale(1.0 - weight, state->velocity_m_s);
    touch_vector velocity = touch_add_scaled(before, weight / since_s, displacement_m);
    state->velocity_m_s = touch_is_finite(velocity) ? velocity : touch_zero();
}

/* -- virtual coupling ------------------------------------------------------------------------------------------------- */

/* A field that is stiffer than the loop can render stably is rendered through a spring K (the virtual coupling of Colgate):
   a proxy q is where F(q) + K (h - q) = 0, and the hand at h gets K (q - h). The proxy moves there by one implicit step in
   each tick, with the field's gradient J: (c - J) dq = F(q) + K (h - q), c = K + max(0, largest eigenvalue of
   (J + J^T) / 2). In a linear field it is there after one step. Where J changes within a step it could jump to and fro for
   ever: when the field (not a hand that turned) pulls it back, the stiffness that it met on its way is added to c, and fades
   within some ticks. */

#define TOUCH_STIFFNESS_DECAY 0.8      /* of the added stiffness, in each tick */
#define TOUCH_MIN_PULL_BACK 0.25       /* of the pull before; less is a proxy that comes to rest, or rounding */
#define TOUCH_NEW_COUPLING 0.5         /* of the compliance of the settings: a coupling that has less is new */
#define TOUCH_CHANGE_PER_TICK 0.02     /* of the way to another damper in contact, and to another coupling */
#define TOUCH_MIN_STEP2_M2 1e-18        /* of the proxy: a shorter step tells no stiffness */

/* The largest eigenvalue of a symmetric matrix with diagonal a, b, c and, beside it, d = xy, e = xz, f = yz. */
static inline double touch_largest_eigenvalue(double a, double b, double c, double d, double e, double f) {
    double mean = (a + b + c) / 3.0;
    a -= mean;
    b -= mean;
    c -= mean;
    double spread = sqrt((a * a + b * b + c * c + 2.0 * (d * d + e * e + f * f)) / 6.0);
    if (!(spread > 0.0)) return mean;
    a /= spread;
    b /= spread;
    c /= spread;
    d /= spread;
    e /= spread;
    f /= spread;
    double half = (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / 2.0;
    return mean + 2.0 * spread * cos(acos(touch_clamp(half, -1.0, 1.0)) / 3.0);
}

/* x with (c - J) x = right. The matrix moves every vector forward, so it is regular. */
static inline touch_vector touch_solve_step(double c, const touch_matrix *j, touch_vector right) {
    double m00 = c - j->row[0].x, m01 = -j->row[0].y, m02 = -j->row[0].z;
    double m10 = -j->row[1].x, m11 = c - j->row[1].y, m12 = -j->row[1].z;
    double m20 = -j->row[2].x, m21 = -j->row[2].y, m22 = c - j->row[2].z;
    double p = m11 * m22 - m12 * m21, q = m12 * m20 - m10 * m22, r = m10 * m21 - m11 * m20;
    double determinant = m00 * p + m01 * q + m02 * r;
    if (!(determinant > 0.0)) return touch_zero(); /* underflow, or not finite */
    touch_vector x_row = touch_vector_of(p, m02 * m21 - m01 * m22, m01 * m12 - m02 * m11);
    touch_vector y_row = touch_vector_of(q, m00 * m22 - m02 * m20, m02 * m10 - m00 * m12);
    touch_vector z_row = touch_vector_of(r, m01 * m20 - m00 * m21, m00 * m11 - m01 * m10);
    return touch_vector_of(touch_dot(x_row, right) / determinant, touch_dot(y_row, right) / determinant,
                           touch_dot(z_row, right) / determinant);
}

/* Stiffness to add to c because the proxy went too far in this tick or in those before, N/m. `pull_n` is what the proxy is
   pulled by at the place of the hand before. */
static inline double touch_added_stiffness(touch_proxy *proxy, touch_vector pull_n) {
    touch_vector step = proxy->coupling_step_m;
    double added = proxy->added_n_per_m * TOUCH_STIFFNESS_DECAY;
    double step2 = touch_dot(step, step);
    double before = touch_dot(proxy->coupling_pull_n, step), now = touch_dot(pull_n, step);
    if (step2 > TOUCH_MIN_STEP2_M2 && now < -TOUCH_MIN_PULL_BACK * before) added = touch_fmax(added, (before - now) / step2);
    proxy->added_n_per_m = added;
    return added;
}

/* Place the proxy at the hand; where the coupling is new in a running contact, it takes over the present force. */
static inline void touch_start_coupling(touch_receiver *receiver, const touch_instant *t, touch_vector hand_m) {
    touch_proxy *proxy = &receiver->state.proxy;
    double k = 1.0 / receiver->state.compliance_m_per_n;
    proxy->is_active = 1;
    proxy->added_n_per_m = 0.0;
    proxy->position_m = proxy->hand_m = hand_m;
    double coupling_n_per_m = touch_shared_double(&receiver->settings.coupling_n_per_m);
    if (receiver->state.compliance_m_per_n * coupling_n_per_m < TOUCH_NEW_COUPLING)
        proxy->position_m = touch_add_scaled(hand_m, 1.0 / k, touch_force_at(t, hand_m));
    proxy->coupling_step_m = proxy->coupling_pull_n = touch_zero();
}

/* The force of the coupling on a hand at `*point_m`, N; `*point_m` becomes the place of the proxy. */
static inline touch_vector touch_coupling_force(touch_receiver *receiver, const touch_instant *t, touch_vector *point_m) {
    touch_proxy *proxy = &receiver->state.proxy;
    double k = 1.0 / receiver->state.compliance_m_per_n;
    touch_vector hand = *point_m;
    if (!proxy->is_active) touch_start_coupling(receiver, t, hand);
    touch_vector q = proxy->position_m, force = touch_force_at(t, q);
    touch_matrix j = touch_gradient_at(t, q, force);
    touch_vector pull = touch_add_scaled(force, k, touch_subtract(hand, q));
    touch_vector hand_step = touch_subtract(hand, proxy->hand_m);
    double c = k + touch_added_stiffness(proxy, touch_add_scaled(pull, -k, hand_step));
    double xy = (j.row[0].y + j.row[1].x) / 2.0, xz = (j.row[0].z + j.row[2].x) / 2.0, yz = (j.row[1].z + j.row[2].y) / 2.0;
    c += touch_fmax(0.0, touch_largest_eigenvalue(j.row[0].x, j.row[1].y, j.row[2].z, xy, xz, yz));
    touch_vector step = touch_solve_step(c, &j, pull);
    q = touch_add(q, step);
    if (!touch_is_finite(q)) {
        proxy->is_active = 0;
        return touch_zero();
    }
    proxy->position_m = *point_m = q;
    proxy->hand_m = hand;
    proxy->coupling_step_m = step;
    proxy->coupling_pull_n = pull;
    return touch_scale(k, touch_subtract(q, hand));
}

/* Approach the damper in contact and the coupling of the settings, at once in the first tick. */
static inline void touch_smooth_settings(touch_receiver *receiver) {
    touch_tick_state *state = &receiver->state;
    double coupling_n_per_m = touch_shared_double(&receiver->settings.coupling_n_per_m);
    double brake_n_s_per_m = touch_shared_double(&receiver->settings.brake_n_s_per_m);
    double compliance = coupling_n_per_m > 0.0 ? 1.0 / coupling_n_per_m : 0.0;
    double weight = state->is_started ? TOUCH_CHANGE_PER_TICK : 1.0;
    state->brake_n_s_per_m += weight * (brake_n_s_per_m - state->brake_n_s_per_m);
    /* the pull changes with the coupling, and then tells nothing of the field */
    if (fabs(compliance - state->compliance_m_per_n) > 1e-3 * compliance) state->proxy.coupling_step_m = touch_zero();
    state->compliance_m_per_n += weight * (compliance - state->compliance_m_per_n);
}

/* -- damping ---------------------------------------------------------------------------------------------------------- */

#define TOUCH_BRAKE_TURN_S 0.005 /* time constant in which the damper follows the direction of the force */

/* A force of the field with the damper in contact, which adds no more than that force. The damper acts along the direction of
   the force, low-passed: a direction that turns at once, as at an edge, would change it by B v at once. It takes energy along
   any direction. */
static inline touch_vector touch_braked(touch_tick_state *state, touch_vector force_n, touch_vector velocity_m_s, double dt_s) {
    double size = touch_norm(force_n);
    if (!(state->brake_n_s_per_m > 0.0 && size > 0.0)) return force_n;
    touch_vector turn = touch_subtract(touch_divided(force_n, size), state->brake_normal);
    state->brake_normal = touch_add_scaled(state->brake_normal, 1.0 - exp(-dt_s / TOUCH_BRAKE_TURN_S), turn);
    double brake_n = state->brake_n_s_per_m * touch_dot(state->brake_normal, velocity_m_s);
    return touch_add_scaled(force_n, -touch_clamp(brake_n, -size, size), state->brake_normal);
}

/* -- vibration -------------------------------------------------------------------------------------------------------- */

/* The phase of a sine after dt, within a turn: the sine stays exact however long it plays. */
static inline double touch_advance_phase(double phase_rad, double turns) {
    turns += phase_rad / (2.0 * TOUCH_PI);
    return 2.0 * TOUCH_PI * (turns - floor(turns));
}

/* Whether a surface stops the proxy, which is then on it, while the hand may be behind a thin wall. */
static inline int touch_is_proxy_stopped(const touch_receiver *receiver) {
    const touch_proxy *proxy = &receiver->state.proxy;
    return receiver->settings.wall_n_per_m > 0.0 && proxy->is_active && proxy->is_in_contact;
}

/* The vibration of the medium at the hand, N, or, where that has none, at the proxy on the surface; zero above half the rate
   of the ticks. */
static inline double touch_vibration_force(touch_receiver *receiver, const touch_instant *t, touch_vector hand_m,
                                           double dt_s) {
    double amplitude, frequency;
    touch_vibration_at(t, hand_m, &amplitude, &frequency);
    if (!(amplitude > 0.0) && touch_is_proxy_stopped(receiver))
        touch_vibration_at(t, receiver->state.proxy.position_m, &amplitude, &frequency);
    if (!(amplitude > 0.0 && frequency > 0.0 && 2.0 * frequency < receiver->settings.rate_hz)) return 0.0;
    double phase = touch_advance_phase(receiver->state.vibration_phase, frequency * dt_s);
    receiver->state.vibration_phase = phase;
    return amplitude * sin(phase);
}

/* -- materials -------------------------------------------------------------------------------------------------------- */

/* A texture is a sum of sines, four in each third of an octave, whose power is that of the table at the speed of the hand
   along the surface and the force that it presses with: linear between, to zero below the first, the last beyond. A band
   that the loop cannot render is left out; what the slew limit forbids makes all weaker by one factor. Stick-slip is a
   sawtooth of mu over the distance, from kinetic to static; where it would go too fast, its mean. */

enum { TOUCH_BAND_SINES = 4, TOUCH_BANDS = TOUCH_SINE_COUNT / TOUCH_BAND_SINES };
#define TOUCH_BAND_EDGE 1.0292005271944282 /* 10^(0.05 / 4): from the highest sine of a band to its edge */
#define TOUCH_UNKNOWN_BODY (-2)

static inline touch_material_sines *touch_sines(const touch_receiver *receiver) {
    return (touch_material_sines *)((char *)receiver + receiver->settings.material_offset);
}

static inline const double *touch_table(const touch_receiver *receiver, int64_t offset) {
    return (const double *)((const char *)receiver + offset);
}

static inline int touch_is_in_box(const touch_material *material, touch_vector p) {
    touch_vector low = material->low_m, high = material->high_m;
    return low.x <= p.x && p.x <= high.x && low.y <= p.y && p.y <= high.y && low.z <= p.z && p.z <= high.z;
}

/* mu of a material, where the hand is on its way between two slips. */
static inline double touch_material_friction(const touch_receiver *receiver, const touch_material *material) {
    double mu = material->friction, static_mu = material->static_friction, slip = material->slip_m;
    double rate = receiver->settings.rate_hz;
    if (isnan(mu)) return receiver->settings.friction;
    if (!(static_mu > mu)) return mu;
    /* from an eighth of the rate on, slips are too many for the loop, and their mean takes over until a quarter */
    double slips_per_s = touch_norm(receiver->state.velocity_m_s) / slip;
    double rendered = touch_clamp((rate / 4.0 - slips_per_s) / (rate / 8.0), 0.0, 1.0);
    double phase = touch_fmin(receiver->state.slid_m / slip, 1.0);
    return mu + (static_mu - mu) * (0.5 + rendered * (phase - 0.5));
}

/* The first material that a point is within, or NULL; `state.friction` becomes that of it. */
static inline const touch_material *touch_find_material(touch_receiver *receiver, const touch_instant *t,
                                                        touch_vector point_m) {
    const touch_settings *settings = &receiver->settings;
    const touch_material *material = (const touch_material *)(touch_sines(receiver) + 1);
    int64_t body = TOUCH_UNKNOWN_BODY;
    /* behind a thin wall there may be no force, hence no body: the proxy stays on the surface */
    if (touch_is_proxy_stopped(receiver)) point_m = receiver->state.proxy.position_m;
    for (int64_t n = 0; n < settings->material_count; n++, material++) {
        if (!touch_is_in_box(material, point_m)) continue;
        if (material->body >= 0) {
            if (body == TOUCH_UNKNOWN_BODY) body = touch_strongest_body(t, point_m);
            if (body != material->body) continue;
        }
        receiver->state.friction = touch_material_friction(receiver, material);
        return material;
    }
    receiver->state.friction = settings->friction;
    return NULL;
}

typedef struct { /* a number between two entries of an ascending row, and how far from the first to the second */
    int64_t low, high;
    double fraction;
} touch_bracket;

/* Before the first entry the lower one is -1 and stands for zero; behind the last, both are the last. */
static inline touch_bracket touch_find(const double *row, int64_t count, double x) {
    touch_bracket found = {-1, 0, 0.0};
    double before = 0.0;
    for (int64_t n = 0; n < count; n++) {
        if (x < row[n]) {
            found.high = n;
            found.fraction = (x - before) / (row[n] - before);
            return found;
        }
        found.low = n;
        before = row[n];
    }
    found.low = found.high = count - 1;
    return found;
}

/* N rms of a band at entry `speed` of the table, and at a force; -1 is zero. */
static inline double touch_band_level(const double *levels, int64_t speed, int64_t force_count, touch_bracket force) {
    if (speed < 0) return 0.0;
    const double *row = levels + speed * force_count * TOUCH_BANDS;
    double low = force.low >= 0 ? row[force.low * TOUCH_BANDS] : 0.0;
    return low + force.fraction * (row[force.high * TOUCH_BANDS] - low);
}

typedef struct {
    double force_n;      /* the sum of the sines */
    double change2_n2_s2; /* mean square of its rate of change */
} touch_sine_sum;

/* Advance the sines of a band by dt, and add them. */
static inline void touch_add_band(touch_sine_sum *chord, touch_material_sines *sines, int band, double level, double dt_s) {
    for (int n = TOUCH_BAND_SINES * band; n < TOUCH_BAND_SINES * (band + 1); n++) {
        double w = sines->frequency_rad_s[n], turns = (sines->phase_rad[n] + w * dt_s) / (2.0 * TOUCH_PI);
        sines->phase_rad[n] = 2.0 * TOUCH_PI * (turns - floor(turns));
        chord->force_n += level * sin(sines->phase_rad[n]);
        chord->change2_n2_s2 += 0.5 * (level * w) * (level * w);
    }
}

/* The vibration of a material, N, for a force of the field and a velocity of the hand; counts the distance to the next slip. */
static inline double touch_texture(touch_receiver *receiver, const touch_material *material, touch_vector force_n,
                                   touch_vector velocity_m_s, double dt_s) {
    const touch_settings *settings = &receiver->settings;
    touch_tick_state *state = &receiver->state;
    double size = touch_norm(force_n);
    if (!(size > 0.0)) return 0.0;
    double normal_speed = touch_dot(velocity_m_s, force_n) / size;
    double speed = touch_norm(touch_add_scaled(velocity_m_s, -normal_speed / size, force_n));
    double distance = state->slid_m + speed * dt_s;
    state->slid_m = distance - material->slip_m * floor(distance / material->slip_m);
    if (!material->force_count) return 0.0;
    touch_bracket at_speed = touch_find(touch_table(receiver, material->speed_offset), material->speed_count, speed);
    touch_bracket at_force = touch_find(touch_table(receiver, material->force_offset), material->force_count, size);
    touch_material_sines *sines = touch_sines(receiver);
    const double *levels = touch_table(receiver, material->level_offset);
    double max_rad_s = TOUCH_PI * settings->rate_hz / TOUCH_BAND_EDGE;
    touch_sine_sum chord = {0.0, 0.0};
    for (int band = 0; band < TOUCH_BANDS; band++) {
        double slow = touch_band_level(levels + band, at_speed.low, material->force_count, at_force);
        double fast = touch_band_level(levels + band, at_speed.high, material->force_count, at_force);
        double level = (slow + at_speed.fraction * (fast - slow)) * sqrt(2.0 / (double)TOUCH_BAND_SINES);
        double highest_rad_s = sines->frequency_rad_s[TOUCH_BAND_SINES * (band + 1) - 1];
        if (level > 0.0 && highest_rad_s < max_rad_s) touch_add_band(&chord, sines, band, level, dt_s);
    }
    double max_change = (double)TOUCH_MATERIAL_CREST * sqrt(chord.change2_n2_s2) * settings->force_scale;
    return max_change > 0.0 ? chord.force_n * touch_fmin(1.0, settings->force_limits.slew_per_s / max_change) : 0.0;
}

/* -- passivity -------------------------------------------------------------------------------------------------------- */

/* The passivity observer adds up what the hand did: a force F that acted while it moved by dx gave it F dx. If the next step
   would give more than was taken before, the passivity controller takes out what is lacking by a damper, F - a v (Hannaford
   and Ryu 2002): no more than cancels what drives the hand and what a hand of 50 g bears in a loop of this rate (m / 2T); the
   rest later. */

#define TOUCH_MIN_HAND_KG 0.05
#define TOUCH_MIN_SPEED_M_S 1e-9 /* slower than this nothing can be damped */
#define TOUCH_MIN_DISTANCE_M 1e-18

/* Add the force before to those that are still to act, without the constant one for the handle's weight. */
static inline void touch_store_past_force(touch_receiver *receiver) {
    touch_tick_state *state = &receiver->state;
    for (int n = TOUCH_PAST_FORCES - 1; n > 0; n--) state->past_forces_n[n] = state->past_forces_n[n - 1];
    state->past_forces_n[0] = touch_add_scaled(state->force.output, -state->gain, receiver->settings.gravity_n);
}

/* Add up the energy of a displacement of the hand, metres of the device, against the force of `delay_ticks` ticks before. */
static inline void touch_passivity_observer(touch_receiver *receiver, touch_vector displacement_m) {
    touch_tick_state *state = &receiver->state;
    double delay = receiver->settings.delay_ticks;
    int whole = (int)touch_clamp(delay, 0.0, TOUCH_MAX_DELAY);
    double work = touch_dot(state->past_forces_n[whole], displacement_m);
    if (delay > whole) work += (delay - whole) * (touch_dot(state->past_forces_n[whole + 1], displacement_m) - work);
    if (isfinite(work)) state->energy_j -= work;
}

/* A force, in the device's axes, with the damper of the passivity controller. Forces that are on their way count as done. */
static inline touch_vector touch_passivity_controller(const touch_receiver *receiver, touch_vector force_n,
                                                      touch_vector velocity_m_s, double dt_s) {
    const touch_settings *settings = &receiver->settings;
    double speed = touch_norm(velocity_m_s);
    double distance = speed * dt_s;
    if (!settings->is_passive || !(speed > TOUCH_MIN_SPEED_M_S && distance > TOUCH_MIN_DISTANCE_M)) return force_n;
    double energy = receiver->state.energy_j, left = settings->delay_ticks;
    for (int n = 0; left > 0.0 && n < TOUCH_PAST_FORCES; n++, left -= 1.0)
        energy -= touch_fmin(left, 1.0) * touch_dot(receiver->state.past_forces_n[n], touch_scale(dt_s, velocity_m_s));
    touch_vector onwards = touch_vector_of(velocity_m_s.x / speed, velocity_m_s.y / speed, velocity_m_s.z / speed);
    double driving = touch_dot(force_n, onwards), lacking = driving - energy / distance;
    if (!(lacking > 0.0)) return force_n;
    double max_braking = touch_fmax(driving, 0.0) + 0.5 * TOUCH_MIN_HAND_KG * settings->rate_hz * speed;
    return touch_add_scaled(force_n, -touch_fmin(lacking, max_braking), onwards);
}

/* -- limits ----------------------------------------------------------------------------------------------------------- */

/* |F| <= limit and |F - F_before| <= slew dt hold of the doubles that are returned, because the limit itself sinks by at
   most half of what the slew limit allows: the force before is shortened to the limit of now, and the rest of the way leads
   straight towards what is desired. The heat H follows |F|^2. With a peak P, and a continuous limit C,

       L^2 = H + r (C^2 - H),    r = 1.5 P^2 / C^2

   is allowed, from C to P. So the peak is allowed up to about a third of C^2. From there on, heat and limit approach C^2 and C
   exponentially, without a step. */

#define TOUCH_LIMIT_USED (1.0 - 1.0 / 1099511627776.0) /* 1 - 2^-40: the rest is for the rounding of those who check */
#define TOUCH_STEP_ROUNDING (1.0 / 562949953421312.0)  /* 2^-49 of a peak: what differences of forces may be off by */
#define TOUCH_HEAT_RATIO 1.5                           /* r C^2 / P^2: the smaller, the shorter and the softer is a peak */

/* Advance the heat by a time in which the force before was put out; the limit that goes with it. */
static inline double touch_heat_limit(const touch_settings *settings, const touch_limits *limits, touch_limited *state,
                                      double dt_s) {
    state->heat += (touch_dot(state->output, state->output) - state->heat) * -expm1(-dt_s / settings->thermal_s);
    if (limits->continuous <= 0.0) return limits->peak;
    double max_heat = limits->continuous * limits->continuous;
    double ratio = TOUCH_HEAT_RATIO * limits->peak * limits->peak / max_heat;
    double square = state->heat + ratio * (max_heat - state->heat);
    return touch_clamp(sqrt(touch_fmax(0.0, square)), limits->continuous, limits->peak);
}

/* The force, N, or torque, N m, that may be put out where `desired` is; stored in the state, with heat and limit. */
static inline touch_vector touch_limit_output(const touch_settings *settings, const touch_limits *limits, touch_limited *state,
                                       touch_vector desired, double dt_s) {
    touch_vector before = state->output;
    if (!touch_is_time_step(settings, dt_s)) return before;
    double limit = touch_heat_limit(settings, limits, state, dt_s);
    if (!touch_is_finite(desired)) desired = touch_zero();
    double max_step = limits->slew_per_s * touch_clamped_dt(settings, dt_s) * TOUCH_LIMIT_USED;
    max_step -= TOUCH_STEP_ROUNDING * limits->peak;
    if (max_step <= 0.0) return before; /* the time is too short for any step that a double can represent */
    limit = touch_fmax(limit, state->limit - 0.5 * max_step);
    state->limit = limit;
    limit *= TOUCH_LIMIT_USED;
    double size = touch_norm(desired);
    if (size > limit) desired = touch_scale(limit / size, desired);
    size = touch_norm(before);
    if (size > limit) {
        before = touch_scale(limit / size, before);
        max_step = touch_fmax(0.0, max_step - (size - limit));
    }
    touch_vector step = touch_subtract(desired, before);
    size = touch_norm(step);
    if (size > max_step) desired = touch_add_scaled(before, max_step / size, step);
    state->output = touch_add(desired, touch_zero()); /* -0.0 becomes 0.0 */
    return state->output;
}

#endif
