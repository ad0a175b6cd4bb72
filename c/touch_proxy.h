/* touch_proxy.h: the proxy, or god object (Zilles and Salisbury 1995; cAlgorithmFingerProxy of CHAI3D): a point that stays
   on a surface while the hand, the device's point, is pressed into it. A spring between both tells how large the force
   should be.

   There is no mesh. The surface is where the force of the field reaches a level, |F| = level_n, and its outward normal is
   the direction of the force (Salisbury and Tarr 1997). A point where |F| is larger is within.

   One tick, from top to bottom of this file:

       touch_contact_force             all of it
           touch_carried_point             the proxy of the tick before, moved with its body       touch_query.h
           touch_motion_of                 how far hand and surface moved since                    touch_proxy_jump.h
           touch_move_proxy                towards the hand along the surface, no friction         touch_proxy_search.h
           touch_store_proxy               for the next tick
           touch_proxy_force               the stored force, and along the spring what this lacks:
               touch_ramp_depth                how far the proxy lies below the foot of the wall's ramp, x
               touch_added_force               how much of what the stored force lacks is added
           touch_ease_jump                 where the proxy jumps, its force comes slowly           touch_proxy_jump.h
           touch_account_work              whether the hand got more work than it did: a damper   touch_proxy_damping.h

   The hand gets the force that the medium stores at the hand, which changes with time as smoothly as the field does, and
   not as a surface that is searched for. The spring is a yardstick, K (|proxy - hand| + x): in a wall that fills its
   neighbourhood the stored force is about that, and nothing is added. Where a wall is thin or has an edge, the stored force is
   smaller or turned, and what it lacks along the spring is added. A hand that no surface stops gets the stored force. What a
   jump of the proxy still owes (eased_n) is subtracted. A virtual coupling makes all of it softer. touch_desired_force adds
   friction.

   Fields are low-passed before they are coded, which rounds the foot of each wall's ramp |F| = K d: x is how far the proxy lies
   below the point where the straight ramp begins. */
#ifndef TOUCH_PROXY_H
#define TOUCH_PROXY_H

#include "touch_proxy_damping.h"
#include "touch_proxy_jump.h"
#include "touch_proxy_search.h"

static inline void touch_store_proxy(touch_proxy *proxy, const touch_instant *t, touch_vector position_m, int is_in_contact);
static inline touch_vector touch_proxy_force(const touch_isosurface *s, double softness, touch_vector hand_m,
                                             touch_vector stored_n);
static inline double touch_ramp_depth(const touch_isosurface *s, touch_vector position_m, touch_vector inwards,
                                      double depth_m);
static inline double touch_added_force(double spring_n, double along_n);

/* -- a tick of the proxy ---------------------------------------------------------------------------------------------- */

/* Times the motion of hand and surface: by so much the proxy may end farther from the hand. */
#define TOUCH_PROXY_AWAY 1.2

/* The force on the hand, N, without friction. One tick of the proxy. */
static inline touch_vector touch_contact_force(touch_receiver *receiver, const touch_instant *t, touch_vector hand_m,
                                               double dt_s) {
    touch_proxy *proxy = &receiver->state.proxy;
    touch_isosurface s = touch_isosurface_of(receiver, t);
    int is_new = !proxy->is_active; /* then it starts at the hand */
    touch_vector start_m = hand_m;
    if (is_new)
        proxy->is_in_contact = 0;
    else
        start_m = touch_carried_point(t, proxy->body, proxy->body_position_m, proxy->position_m);
    touch_field_point carried = touch_probe(&s, start_m), found = carried;
    touch_contact_motion motion = {{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}, 0.0};
    if (!is_new) motion = touch_motion_of(&s, hand_m, carried);
    int is_in_contact = touch_move_proxy(&s, hand_m, TOUCH_PROXY_AWAY * motion.total_m, &found);
    touch_store_proxy(proxy, t, found.position_m, is_in_contact); /* position_m is of this tick now, force_n and stored_n not */
    int is_away = !is_in_contact && touch_distance(found.position_m, hand_m) > s.max_step_m;
    proxy->released_s = is_away && !is_new ? proxy->released_s + dt_s : 0.0;

    /* the coupling makes the whole field softer, so that neither contact nor a thin wall changes how stiff it is */
    double softness = 1.0 / (1.0 + s.stiffness_n_per_m * receiver->state.compliance_m_per_n);
    touch_vector stored = touch_scale(softness, touch_force_at(t, hand_m));
    touch_vector force = is_in_contact ? touch_proxy_force(&s, softness, hand_m, stored) : stored;
    if (is_new) {
        proxy->eased_n = touch_zero(); /* it owes nothing */
        touch_start_swing(&proxy->swing);
    } else {
        touch_ease_jump(&s, &motion, force, stored, dt_s);
        touch_account_work(&s, &motion, dt_s);
    }
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
#define TOUCH_PROXY_SMALL_LACK 0.2            /* of the spring's force: less than this the stored force may lack */
#define TOUCH_PROXY_EDGE_COSINE 0.85          /* between the stored force and the spring: up to this it is an edge, */
#define TOUCH_PROXY_EDGE_WIDTH 0.13           /* and from so much more on a surface */

/* The force of the proxy on the hand, N: the stored one, and along the spring what this lacks. Across the spring the stored
   force counts in full where both have about one direction, and not at an edge. */
static inline touch_vector touch_proxy_force(const touch_isosurface *s, double softness, touch_vector hand_m,
                                             touch_vector stored_n) {
    touch_vector proxy_m = s->receiver->state.proxy.position_m, pull = touch_subtract(proxy_m, hand_m);
    double depth_m = touch_magnitude(pull), stored = touch_magnitude(stored_n);
    if (!(depth_m > 0.0)) return stored_n;
    touch_vector outwards = touch_scale(1.0 / depth_m, pull);
    double ramp_depth_m = touch_ramp_depth(s, proxy_m, touch_scale(-1.0, outwards), depth_m);
    double spring_n = softness * s->stiffness_n_per_m * (depth_m + ramp_depth_m);
    double along_n = touch_dot(stored_n, outwards), weight = 0.0;
    if (stored > 0.0) weight = touch_smooth_step((along_n / stored - TOUCH_PROXY_EDGE_COSINE) / TOUCH_PROXY_EDGE_WIDTH);
    touch_vector force = touch_scale(weight, touch_add_scaled(stored_n, -along_n, outwards));
    along_n = touch_fmax(0.0, along_n); /* a stored force that pulls inwards counts as none */
    return touch_add_scaled(force, along_n + touch_added_force(spring_n, along_n), outwards);
}

/* x, metres: how far a proxy lies below the point where the ramp of the wall behind it begins; negative above. The larger one
   of two estimates: from the force two samples behind, where the low-pass of the field is over, and one sample behind, less a
   margin, as the wall may end before two. Within a sample, and up to half the depth of the hand, so that it grows from
   zero. */
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

/* What is added to a stored force along the spring, N. It lacks the rest of the spring's force; a small lack is only that of
   two approximations, and nearly all of a large one is added. Where the stored force falls by S per metre, as from the middle
   of a wall on, the sum rises by at most 1.25 S + K: without a switch from the one to the other. */
static inline double touch_added_force(double spring_n, double along_n) {
    double lack_n = spring_n - along_n;
    if (!(lack_n > TOUCH_PROXY_SMALL_LACK * spring_n)) return 0.0;
    return lack_n * (lack_n / spring_n - TOUCH_PROXY_SMALL_LACK) / (1.0 - TOUCH_PROXY_SMALL_LACK);
}

#endif
