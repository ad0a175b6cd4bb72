/* touch_friction.h: dry friction with an anchor, for the proxy, the field, tools and deformed media.

   The anchor is the point of the surface that the hand stuck to last. A spring and a damper pull the hand back to it along
   the surface. Where they would pull by more than mu |F|, the anchor slides after, so that the spring alone pulls by mu |F|:
   the model of Hayward and Armstrong (2000), Dahl's with an edge. Friction depends on positions and not on a measured speed,
   so that a hand at rest is held by a force that does not change. A body that moves carries the anchor; the damper takes the
   velocity of its surface low-passed.

   The spring is as stiff as the loop of the device renders stably (touch_choose_stick), and the damper is the one that it
   needs. Both only take energy out over a cycle: what stretches the spring comes back, and what slides is lost. */
#ifndef TOUCH_FRICTION_H
#define TOUCH_FRICTION_H

#include "touch_query.h"
#include "touch_segment_blend.h"

#define TOUCH_IN_CONE (1.0 - 1.0 / 549755813888.0) /* 1 - 2^-39: rounding never lifts friction out of its cone */

typedef struct { /* one tick of friction */
    double max_n;                          /* mu |F|, with the mu of the material, else of the settings */
    double stick_n_per_m, stick_n_s_per_m; /* spring and damper */
    touch_vector normal;                   /* of the surface, F / |F| */
    touch_vector velocity_m_s;             /* of the hand, beside that of the surface */
} touch_friction_rule;

/* What is left of a vector along the surface. */
static inline touch_vector touch_along_surface(touch_vector v, touch_vector normal) {
    return touch_add_scaled(v, -touch_dot(v, normal), normal);
}

/* Store the anchor, also in the axes of the body that it is on. */
static inline void touch_store_anchor(touch_stick_anchor *anchor, const touch_instant *t, touch_vector anchor_m, int64_t body) {
    anchor->is_set = 1;
    anchor->position_m = anchor_m;
    anchor->body = body;
    anchor->body_position_m = touch_point_in_body(t, body, anchor_m);
}

#define TOUCH_STICK_SURFACE_S 0.008 /* time constant of the velocity of the surface */

/* The velocity of the surface at an anchor that it carried to `carried_m`, m/s. It is low-passed: where a body is hit, or the
   hand comes from one body to the next, it would jump, and the damper's force with it. */
static inline touch_vector touch_surface_velocity(touch_stick_anchor *anchor, touch_vector carried_m, double dt_s) {
    touch_vector now_m_s = touch_scale(1.0 / dt_s, touch_subtract(carried_m, anchor->position_m));
    double weight = anchor->is_followed ? -expm1(-dt_s / TOUCH_STICK_SURFACE_S) : 1.0;
    touch_vector change_m_s = touch_subtract(now_m_s, anchor->surface_m_s);
    anchor->surface_m_s = touch_add_scaled(anchor->surface_m_s, weight, change_m_s);
    anchor->is_followed = 1;
    return anchor->surface_m_s;
}

/* The friction on a point at the surface, N, along it and at most max_n. The anchor slides where it must, in `*anchor_m`. */
static inline touch_vector touch_stick_friction(const touch_friction_rule *rule, touch_vector point_m, touch_vector *anchor_m) {
    double max_n = rule->max_n * TOUCH_IN_CONE, k = rule->stick_n_per_m;
    touch_vector stretch = touch_along_surface(touch_subtract(*anchor_m, point_m), rule->normal);
    double spring_n = k * touch_norm(stretch);
    if (!(spring_n < HUGE_VAL)) stretch = touch_zero();
    else if (spring_n > max_n) stretch = touch_scale(max_n / spring_n, stretch);
    *anchor_m = touch_add(point_m, stretch);
    touch_vector slip = touch_along_surface(rule->velocity_m_s, rule->normal);
    touch_vector friction = touch_add_scaled(touch_scale(k, stretch), -rule->stick_n_s_per_m, slip);
    double size = touch_norm(friction);
    if (!(size < HUGE_VAL)) return touch_zero();
    return size > max_n ? touch_scale(max_n / size, friction) : friction;
}

/* How hard a hand is pressed, N, by a force of the field: after a seam, a larger force than before fades in. */
static inline double touch_pressing_n(const touch_seam *seam, double force_n) {
    if (!(seam->left_s > 0.0)) return force_n;
    return touch_fmin(force_n, force_n + touch_fade_weight(seam->left_s) * (seam->pressed_n - force_n));
}

/* Friction on the hand, N, in the field's axes, where a force presses a point of it against a surface. */
static inline touch_vector touch_friction_force(touch_receiver *receiver, const touch_instant *t, touch_vector point_m,
                                                int64_t body, touch_vector force_n, double dt_s) {
    const touch_settings *settings = &receiver->settings;
    touch_tick_state *state = &receiver->state;
    touch_stick_anchor *anchor = &state->anchor;
    double size = touch_norm(force_n);
    if (!(size > 0.0 && state->friction > 0.0 && settings->stick_n_per_m > 0.0)) {
        anchor->is_set = 0;
        return touch_zero();
    }
    touch_vector anchor_m = point_m, velocity = state->velocity_m_s;
    if (anchor->is_set) {
        anchor_m = touch_carried_point(t, anchor->body, anchor->body_position_m, anchor->position_m);
        velocity = touch_subtract(velocity, touch_surface_velocity(anchor, anchor_m, dt_s));
    } else {
        anchor->is_followed = 0;
        anchor->surface_m_s = touch_zero();
    }
    touch_friction_rule rule;
    rule.max_n = state->friction * touch_pressing_n(&state->seam, size);
    rule.stick_n_per_m = settings->stick_n_per_m;
    rule.stick_n_s_per_m = settings->stick_n_s_per_m;
    rule.normal = touch_divided(force_n, size);
    rule.velocity_m_s = velocity;
    touch_vector friction = touch_stick_friction(&rule, point_m, &anchor_m);
    touch_store_anchor(anchor, t, anchor_m, body);
    return friction;
}

#endif
