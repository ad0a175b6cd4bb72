/* touch_proxy_jump.h: jumps of the proxy of touch_proxy.h, to another surface, or on or off one, reach the hand slowly.

   The force changes at once by as much as the field itself changes at the hand: along that change, and in other directions as
   far as the hand moves. The rest of a change is owed. It comes with time, and with the motion of the hand by K per metre,
   less half of what the field may pass on: in full where it works against the motion, half where it lies across it, and not
   where it works along it, so that it drives no hand. The motion is that of the hand beside the body that
   carries the proxy, or in space, whichever gives less: neither a body that moves past a hand at rest, nor one that takes the
   hand along, brings what is owed. Of a force that falls at most 70 % stay owed. In free space of a medium of one frame what is
   owed comes with motion in any direction, as after a slip round a rim: no wall can come back there that it would have
   softened. */
#ifndef TOUCH_PROXY_JUMP_H
#define TOUCH_PROXY_JUMP_H

#include "touch_proxy_search.h"

#define TOUCH_PROXY_EASE_S 1.0                /* in which a jump by a large force of the field comes to a hand at rest, */
#define TOUCH_PROXY_EASE_SMALL_S 0.5          /* and time constant for a small one */
#define TOUCH_PROXY_EASE_PASSED 0.5           /* of what changed at once: so much less comes with the motion */
#define TOUCH_PROXY_EASE_SHARE 0.7            /* of a force that falls: more of it is not owed any longer */
#define TOUCH_PROXY_EASE_TURN 10.0            /* times K and the motion of the hand: so far a change may turn off the field's */

typedef struct { /* in a tick */
    touch_vector hand_m;   /* of the hand, relative to the body that carries the proxy */
    touch_vector space_m;  /* of the hand in space */
    touch_vector beside_m; /* of the hand, relative to the surface at the proxy */
    double total_m;        /* how far hand and surface moved, relative to that body */
} touch_contact_motion;

/* How far hand and surface moved since the tick before. */
static inline touch_contact_motion touch_motion_of(const touch_isosurface *s, touch_vector hand_m, touch_field_point carried) {
    const touch_proxy *proxy = &s->receiver->state.proxy;
    touch_vector carry_m = touch_subtract(carried.position_m, proxy->position_m);
    touch_contact_motion motion;
    motion.space_m = touch_subtract(hand_m, proxy->hand_m);
    motion.hand_m = touch_subtract(motion.space_m, carry_m);
    double surface_m = (carried.force_n - proxy->surface_n) / s->stiffness_n_per_m; /* by so much it came out of that body */
    motion.beside_m = touch_add_scaled(motion.hand_m, -surface_m, carried.normal);
    motion.total_m = touch_magnitude(motion.hand_m) + fabs(surface_m);
    return motion;
}

/* A vector, shortened by a length. */
static inline touch_vector touch_shortened(touch_vector v, double length) {
    double size = touch_magnitude(v);
    return size > length ? touch_scale(1.0 - length / size, v) : touch_zero();
}

/* True if neither a surface nor the field holds the hand, and the medium does not change, so that none will while it rests. */
static inline int touch_is_free_for_good(const touch_isosurface *s, touch_vector stored_n) {
    if (s->receiver->layout.frame_count > 1 || s->receiver->state.proxy.is_in_contact) return 0;
    return touch_magnitude(stored_n) < TOUCH_PROXY_FREE_LEVELS * s->level_n;
}

/* How much of what is owed comes with the motion of the hand, N, where the force changed by `passed_n` at once. */
static inline double touch_given_by_motion(const touch_isosurface *s, touch_vector hand_m, touch_vector owed_n,
                                           double passed_n, int is_free) {
    double size_n = touch_magnitude(owed_n);
    if (!(size_n > 0.0)) return 0.0;
    if (is_free) return s->stiffness_n_per_m * touch_magnitude(hand_m);
    double along_m = touch_dot(hand_m, owed_n) / size_n;
    double against_m = 0.5 * (touch_magnitude(hand_m) - along_m);
    return touch_fmax(0.0, s->stiffness_n_per_m * against_m - TOUCH_PROXY_EASE_PASSED * passed_n);
}

/* What reaches the hand at once, N, of a change of the proxy's force that is no larger than `own_n`, the field's own change.
   A proxy that slides about while the hand rests would turn the change of the force to and fro, a kink each time: so what
   lies off the field's own change is limited by the motion of the hand. */
static inline touch_vector touch_passed_change(const touch_isosurface *s, touch_vector hand_m, touch_vector change_n,
                                               touch_vector own_n) {
    double square = touch_dot(own_n, own_n);
    if (!(square > 0.0)) return touch_zero();
    touch_vector along_n = touch_scale(touch_clamp(touch_dot(change_n, own_n) / square, 0.0, 1.0), own_n);
    touch_vector across_n = touch_subtract(change_n, along_n);
    double limit_n = TOUCH_PROXY_EASE_TURN * s->stiffness_n_per_m * touch_magnitude(hand_m);
    return touch_subtract(change_n, touch_shortened(across_n, limit_n));
}

/* What is owed of a force, N, after this fell by `passed_n`, a change that is passed on: it falls as well, where it is most of
   the force. Otherwise a hand that leaves a wall faster than it is given back would feel none, or be drawn in. */
static inline touch_vector touch_owed_of_falling(touch_vector owed_n, touch_vector force_n, touch_vector passed_n) {
    double size = touch_magnitude(force_n);
    if (!(size > 0.0)) return owed_n;
    double fall_n = -touch_dot(passed_n, force_n) / size;
    double excess_n = touch_dot(owed_n, force_n) / size - TOUCH_PROXY_EASE_SHARE * size;
    return touch_add_scaled(owed_n, -touch_fmax(0.0, touch_fmin(fall_n, excess_n)) / size, force_n);
}

/* Pass on what the field explains of a change of the proxy's force, and give back some of what is owed. */
static inline void touch_ease_jump(const touch_isosurface *s, const touch_contact_motion *motion, touch_vector force_n,
                                   touch_vector stored_n, double dt_s) {
    touch_proxy *proxy = &s->receiver->state.proxy;
    touch_vector change_n = touch_subtract(force_n, proxy->force_n), own_n = touch_subtract(stored_n, proxy->stored_n);
    double passed_n = touch_fmin(touch_magnitude(change_n), touch_magnitude(own_n));
    touch_vector within_n = touch_subtract(change_n, touch_shortened(change_n, passed_n));
    touch_vector at_once_n = within_n; /* in no time, at a seam, which fades */
    if (dt_s > 0.0) at_once_n = touch_passed_change(s, motion->hand_m, within_n, own_n);
    touch_vector owed_n = touch_add(proxy->eased_n, touch_subtract(change_n, at_once_n));
    owed_n = touch_owed_of_falling(owed_n, force_n, at_once_n);
    int is_free = touch_is_free_for_good(s, stored_n);
    double given_n = touch_fmin(touch_given_by_motion(s, motion->hand_m, owed_n, passed_n, is_free),
                                touch_given_by_motion(s, motion->space_m, owed_n, passed_n, is_free));
    owed_n = touch_shortened(owed_n, given_n);
    double given_n_per_s = touch_fmin(touch_magnitude(owed_n) / TOUCH_PROXY_EASE_SMALL_S, s->large_n / TOUCH_PROXY_EASE_S);
    proxy->eased_n = touch_shortened(owed_n, given_n_per_s * dt_s);
}

#endif
