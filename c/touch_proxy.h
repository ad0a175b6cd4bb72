/* touch_proxy.h: the proxy, or god object (Zilles and Salisbury 1995; cAlgorithmFingerProxy of CHAI3D): a point that stays
   on a surface while the hand, the device's point, is pressed into it. A spring pulls the hand towards it.

   There is no mesh. The surface is where the force of the field reaches a level, |F| = level_n, and its outward normal is
   the direction of the force (Salisbury and Tarr 1997). A point where |F| is larger is within.

   One tick, from top to bottom of this file:

       touch_contact_force             all of it
           touch_carried_point             the proxy of the tick before, moved with its body       touch_query.h
           touch_move_proxy                towards the hand along the surface, no friction         touch_proxy_search.h
           touch_store_proxy               for the next tick
           touch_proxy_force               a spring, or the stored force where this is that of the same wall:
               touch_ramp_depth                how far the proxy lies below the surface of what was coded, x
               touch_field_share               how far the stored force is that of this wall
           touch_ease_jump                 where the proxy jumped, its force comes slowly

   The force is F = K' (|proxy - hand| + x) along proxy - hand, at least what the stored force is along it, less what a jump
   still owes (eased_n). K' is the stiffness K of the walls in series with the virtual coupling. The low-pass of a field
   makes a ramp of each wall, and x extrapolates that ramp. Where the stored force at the hand agrees with that spring, it is
   rendered itself; where a wall is thin or has an edge, the spring still stops the hand. Friction acts at the proxy
   (touch_friction.h). */
#ifndef TOUCH_PROXY_H
#define TOUCH_PROXY_H

#include "touch_proxy_search.h"

typedef struct { /* in a tick, beside the body that carries the proxy */
    double hand_m;    /* how far the hand moved */
    double surface_n; /* by how much |F| changed at the proxy */
    double total_m;   /* how far hand and surface moved */
} touch_contact_motion;

static inline touch_contact_motion touch_motion_of(const touch_isosurface *s, touch_vector hand_m, touch_field_point carried);
static inline void touch_store_proxy(touch_proxy *proxy, const touch_instant *t, touch_vector position_m, int is_in_contact);
static inline touch_vector touch_proxy_force(const touch_isosurface *s, touch_vector hand_m, touch_vector stored_n);
static inline double touch_ramp_depth(const touch_isosurface *s, touch_vector position_m, touch_vector inwards,
                                      double depth_m);
static inline void touch_ease_jump(const touch_isosurface *s, const touch_contact_motion *motion, double step_m,
                                   touch_vector force_n, touch_vector stored_n, double dt_s);

/* -- a tick of the proxy ---------------------------------------------------------------------------------------------- */

/* The force on the hand, N, without friction. One tick of the proxy. Friction acts at the proxy, state.proxy.position_m. */
static inline touch_vector touch_contact_force(touch_receiver *receiver, const touch_instant *t, touch_vector hand_m,
                                               double dt_s) {
    const touch_settings *settings = &receiver->settings;
    touch_proxy *proxy = &receiver->state.proxy;
    touch_isosurface s = {receiver, t, settings->wall_n_per_m, settings->wall_level_n, settings->wall_force_n, 0.0,
                          settings->wall_spacing_m};
    s.max_step_m = 0.5 * touch_fmin(touch_fmin(s.spacing_m.x, s.spacing_m.y), s.spacing_m.z);

    int is_new = !proxy->is_active;
    touch_vector carried_m = touch_carried_point(t, proxy->body, proxy->body_position_m, proxy->position_m);
    touch_field_point carried = touch_probe(&s, is_new ? hand_m : carried_m), found = carried;
    touch_contact_motion motion = touch_motion_of(&s, hand_m, carried);
    int is_in_contact = touch_move_proxy(&s, hand_m, &found);
    touch_store_proxy(proxy, t, found.position_m, is_in_contact);

    touch_vector stored = touch_force_at(t, hand_m);
    touch_vector force = is_in_contact ? touch_proxy_force(&s, hand_m, stored) : stored;
    double step_m = touch_magnitude(touch_subtract(found.position_m, carried.position_m));
    if (is_new)
        proxy->eased_n = touch_zero();
    else
        touch_ease_jump(&s, &motion, step_m, force, stored, dt_s);
    proxy->surface_n = found.force_n;
    proxy->hand_m = hand_m;
    proxy->force_n = force;
    proxy->stored_n = stored;
    return touch_subtract(force, proxy->eased_n);
}

/* Store the position of the proxy, also in the axes of the body that pushes most there. */
static inline void touch_store_proxy(touch_proxy *proxy, const touch_instant *t, touch_vector position_m, int is_in_contact) {
    proxy->is_active = 1;
    proxy->is_in_contact = is_in_contact;
    proxy->position_m = position_m;
    proxy->body = is_in_contact ? touch_carrying_body(t, position_m) : -1;
    proxy->body_position_m = touch_point_in_body(t, proxy->body, position_m);
}

/* -- the force -------------------------------------------------------------------------------------------------------- */

#define TOUCH_PROXY_RAMP_DOUBT 0.05           /* samples: by so much a ramp within the low-pass overestimates */
#define TOUCH_PROXY_EDGE_COSINE 0.85          /* between the stored force and that of the spring: up to this it is an edge, */
#define TOUCH_PROXY_EDGE_WIDTH 0.13           /* and from so much more on a surface */

/* The force of the proxy on the hand, N: the stored force, and along the spring as much as it lacks. */
static inline touch_vector touch_proxy_force(const touch_isosurface *s, touch_vector hand_m, touch_vector stored_n) {
    const touch_tick_state *state = &s->receiver->state;
    touch_vector pull = touch_subtract(state->proxy.position_m, hand_m);
    double k = s->stiffness_n_per_m, depth = touch_magnitude(pull);
    if (!(depth > 0.0)) return stored_n;
    touch_vector outwards = touch_scale(1.0 / depth, pull);
    double spring_n = k * (depth + touch_ramp_depth(s, state->proxy.position_m, touch_scale(-1.0, outwards), depth));
    double along_n = touch_dot(stored_n, outwards), stored = touch_magnitude(stored_n);
    double lack_n = touch_clamp(spring_n - along_n, 0.0, spring_n);
    double size_n = touch_fmax(along_n, 0.0);
    if (lack_n > 0.0) size_n += lack_n * lack_n / spring_n;
    double tangential = stored > 0.0 ? touch_smooth_step((along_n / stored - TOUCH_PROXY_EDGE_COSINE) / TOUCH_PROXY_EDGE_WIDTH) : 0.0;
    touch_vector force = touch_scale(size_n, outwards);
    force = touch_add_scaled(force, tangential, touch_add_scaled(stored_n, -along_n, outwards));
    /* a coupling makes the wall softer, and so what it stores */
    return touch_scale(1.0 / (1.0 + k * state->compliance_m_per_n), force);
}

/* Depth of a proxy below the surface that the ramp of forces behind it extrapolates to, metres; negative above. Two samples
   behind the surface the low-pass of the field is over. Where the force has its maximum before that, or the wall ends, the
   force half as far behind is taken, with a margin. At most half the depth of the hand, so that x grows from zero. */
static inline double touch_ramp_depth(const touch_isosurface *s, touch_vector position_m, touch_vector inwards,
                                      double depth_m) {
    double sample = touch_sample_length(s, inwards), k = s->stiffness_n_per_m;
    double deep_n = touch_probe(s, touch_add_scaled(position_m, TOUCH_PROXY_RAMP_SAMPLES * sample, inwards)).force_n;
    double shallow_n = touch_probe(s, touch_add_scaled(position_m, sample, inwards)).force_n;
    double depth = deep_n / k - TOUCH_PROXY_RAMP_SAMPLES * sample;
    depth = touch_fmax(depth, shallow_n / k - (1.0 + TOUCH_PROXY_RAMP_DOUBT) * sample);
    depth = touch_fmax(depth, -sample);
    return touch_fmin(touch_fmin(depth, sample), 0.5 * depth_m);
}

/* -- jumps of the proxy ----------------------------------------------------------------------------------------------- */

#define TOUCH_PROXY_EASE_S 1.0                /* in which the correction at rest may change by a large force of the field */
#define TOUCH_PROXY_FOLLOW 2.0                /* times the motion of hand and surface: a longer step is a jump */

/* How far hand and surface moved since the tick before. */
static inline touch_contact_motion touch_motion_of(const touch_isosurface *s, touch_vector hand_m, touch_field_point carried) {
    const touch_proxy *proxy = &s->receiver->state.proxy;
    touch_vector carry_m = touch_subtract(carried.position_m, proxy->position_m);
    touch_contact_motion motion;
    motion.hand_m = touch_magnitude(touch_subtract(touch_subtract(hand_m, proxy->hand_m), carry_m));
    motion.surface_n = fabs(carried.force_n - proxy->surface_n);
    motion.total_m = motion.hand_m + motion.surface_n / s->stiffness_n_per_m;
    return motion;
}

/* A vector, shortened by a length. */
static inline touch_vector touch_shortened(touch_vector v, double length) {
    double size = touch_magnitude(v);
    return size > length ? touch_scale(1.0 - length / size, v) : touch_zero();
}

/* The force follows that of the proxy by as much as the field's own changes, and the motion of the hand and time allow. */
static inline void touch_ease_jump(const touch_isosurface *s, const touch_contact_motion *motion, double step_m,
                                   touch_vector force_n, touch_vector stored_n, double dt_s) {
    touch_proxy *proxy = &s->receiver->state.proxy;
    (void)step_m;
    touch_vector before_n = touch_subtract(proxy->force_n, proxy->eased_n);
    double allowed_n = touch_magnitude(touch_subtract(stored_n, proxy->stored_n));
    allowed_n += TOUCH_PROXY_FOLLOW * s->stiffness_n_per_m * motion->hand_m + s->large_n * dt_s / TOUCH_PROXY_EASE_S;
    proxy->eased_n = touch_shortened(touch_subtract(force_n, before_n), allowed_n);
}

#endif
