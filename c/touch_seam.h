/* touch_seam.h: where a part of a medium begins that does not go on from the one before: the start of a loop, a seek, frames
   that were late, another layer of a stream. The force on the hand goes from the one to the other in TOUCH_BLEND_S, as bricks
   do where a segment starts.

   A pose cannot be blended: a body that is elsewhere after a seam would run there within one frame, through the hand. So the
   frame before the seam is shown until the frame after it is due. Then what the force was larger by fades out, as a raised
   cosine w from 1 to 0:

       F = F_after + w (F_before - F_after in the first tick)

   The hand has the stiffness and the proxy of the field after the seam from the first tick on; friction is that of the smaller
   force while the larger one fades in. Where the field is the same on both sides, nothing is added. |F| is at most the larger
   one of |F_before| and |F_after|. A wall that has come over the hand pushes as slowly as after any other jump of the proxy
   (touch_proxy_jump.h).

   A receiver whose segments are not blended (layout.is_unblended) has no fades either: the force steps, as far as the slew
   limit lets it.

   A loop whose end goes on into its start, as a body that turns, has no seam: where the frames differ by at most twice as much
   as the two before them, they are interpolated as any others are. */
#ifndef TOUCH_SEAM_H
#define TOUCH_SEAM_H

#include "touch_friction.h"
#include "touch_proxy.h"
#include "touch_segment_blend.h"
#include "touch_shared.h"
#include "touch_tool.h"

#define TOUCH_SEAM_RATIO 2.0     /* of the changes of two pairs of frames: a larger one is a jump */
#define TOUCH_SEAM_MIN_M 1e-6    /* of a body's surface: a smaller change is none */
#define TOUCH_SEAM_MIN_N 1e-3    /* of a force */
#define TOUCH_MAX_CARRY_M 1e-3   /* in a tick: a body that went farther has jumped, and carries nothing */
#define TOUCH_SEAM_KEEP_S 0.25   /* how long late frames leave the proxy where it is: a hand reacts to nothing sooner */
#define TOUCH_SEAM_SEARCHES 8    /* of the proxy in the first tick: one that the new field covers gets out of it */

/* -- whether a medium jumps from a frame to the next ------------------------------------------------------------------- */

/* How far a body's surface moves between the frames of an instant, metres, at most. */
static inline double touch_body_shift_m(const touch_instant *t, int64_t body) {
    touch_body_pair b = touch_pair_of(t, body);
    const double *p = b.before->quaternion, *q = b.after->quaternion;
    double near2 = 0.0, far2 = 0.0; /* a quaternion and its negative are one rotation */
    for (int n = 0; n < 4; n++) {
        near2 += (q[n] - p[n]) * (q[n] - p[n]);
        far2 += (q[n] + p[n]) * (q[n] + p[n]);
    }
    double reach_m = sqrt(touch_fmax(touch_reach2_of(&b), 0.0));
    return touch_norm(touch_subtract(b.after->position_m, b.before->position_m)) +
           2.0 * reach_m * sqrt(touch_fmin(near2, far2));
}

/* The force of the field on a hand at a point, or on a tool there, N. */
static inline touch_vector touch_hand_force(const touch_receiver *receiver, const touch_instant *t, touch_vector point_m) {
    touch_vector torque;
    if (TOUCH_HAS_EXTRAS && receiver->settings.tool_point_count > 0) return touch_tool_force(receiver, t, point_m, &torque);
    return touch_force_at(t, point_m);
}

/* By how much the force of the frame after an instant on a hand differs from that of the frame before, N. */
static inline double touch_force_change_n(const touch_receiver *receiver, const touch_instant *t, touch_vector point_m) {
    touch_instant before = *t, after = *t;
    before.after = t->before, after.before = t->after;
    before.blend = after.blend = 0.0;
    touch_vector force_before = touch_hand_force(receiver, &before, point_m);
    return touch_norm(touch_subtract(touch_hand_force(receiver, &after, point_m), force_before));
}

/* Whether a medium jumps between the frames of an instant; `own`: from the frame before them to the first of them. */
static inline int touch_is_jump(const touch_receiver *receiver, const touch_instant *t, const touch_instant *own) {
    const touch_body_pose *poses = (const touch_body_pose *)(const void *)(t->before + 1);
    int64_t count = poses->is_identity ? 0 : touch_body_count(t);
    for (int64_t n = 0; n < count; n++) {
        double own_m = n < touch_body_count(own) ? touch_body_shift_m(own, n) : 0.0;
        if (touch_body_shift_m(t, n) > TOUCH_SEAM_RATIO * own_m + TOUCH_SEAM_MIN_M) return 1;
    }
    if (receiver->layout.frame_rate_hz * receiver->clock.speed <= TOUCH_MAX_UNBLENDED_HZ) return 0;
    touch_vector point = receiver->state.position_m;
    double own_n = touch_force_change_n(receiver, own, point);
    return touch_force_change_n(receiver, t, point) > TOUCH_SEAM_RATIO * own_n + TOUCH_SEAM_MIN_N;
}

/* -- over a seam ------------------------------------------------------------------------------------------------------- */

/* Whether a body has gone too far to carry a point that is fixed to it. */
static inline int touch_has_body_jumped(const touch_instant *t, int64_t body, touch_vector in_body_m, touch_vector point_m) {
    touch_vector carry = touch_subtract(touch_carried_point(t, body, in_body_m, point_m), point_m);
    return !(touch_norm(carry) <= TOUCH_MAX_CARRY_M);
}

/* Leave the proxy where it is if its body has jumped, and the anchor of friction behind. */
static inline void touch_stay_in_place(touch_receiver *receiver, const touch_instant *t) {
    touch_tick_state *state = &receiver->state;
    touch_proxy *proxy = &state->proxy;
    touch_stick_anchor *anchor = &state->anchor;
    if (proxy->is_active && touch_has_body_jumped(t, proxy->body, proxy->body_position_m, proxy->position_m)) proxy->body = -1;
    if (anchor->is_set && touch_has_body_jumped(t, anchor->body, anchor->body_position_m, anchor->position_m))
        anchor->is_set = 0;
    if (!(receiver->settings.wall_n_per_m > 0.0)) return;
    for (int n = 0; n < TOUCH_SEAM_SEARCHES; n++) (void)touch_contact_force(receiver, t, state->position_m, 0.0);
    if (!(touch_dot(proxy->eased_n, proxy->force_n) > 0.0)) proxy->eased_n = touch_zero(); /* a force that is gone: it fades */
}

/* Whether the proxy stays where it is without a frame: those to come may have the wall that held the hand. */
static inline int touch_is_proxy_kept(const touch_receiver *receiver) {
    const touch_clock *clock = &receiver->clock;
    const touch_tick_state *state = &receiver->state;
    if (clock->mode == TOUCH_IDLE || clock->feed == TOUCH_ENDED || clock->is_silent) return 0;
    if (!state->is_started || touch_shared(&receiver->orders.has_feed_failed)) return 0;
    return state->proxy.is_active && receiver->settings.wall_n_per_m > 0.0 && state->seam.late_s < TOUCH_SEAM_KEEP_S;
}

/* Whether the force fades as frames of a seek, or late ones, are still to come. Where it was ramping down already, it goes on
   to. */
static inline int touch_is_fading_out(const touch_receiver *receiver) {
    const touch_tick_state *state = &receiver->state;
    if (!state->seam.is_waiting || receiver->layout.is_unblended) return 0;
    return state->gain > 0.0 && (state->seam.left_s > 0.0 || !state->seam.is_field_missing);
}

/* By how much the motion of the hand since the tick before changes the force of the field, N, in the device's axes: no
   part of what changes at a seam. Before the gain is that of this tick: where it was zero, there was no force to go on. */
static inline touch_vector touch_motion_change(const touch_receiver *receiver, const touch_instant *t) {
    const touch_settings *settings = &receiver->settings;
    const touch_tick_state *state = &receiver->state;
    if (state->seam.is_field_missing || !(state->gain > 0.0)) return touch_zero();
    touch_vector now = touch_hand_force(receiver, t, state->position_m);
    touch_vector change = touch_subtract(now, touch_hand_force(receiver, t, state->seam.hand_m));
    return touch_scale(settings->force_scale, touch_rotate_back(&settings->axes, change));
}

/* Fade from the force and the torque of the tick before to those of this one, in TOUCH_BLEND_S. */
static inline void touch_start_fade(touch_seam *seam, touch_vector force_n, touch_vector torque_nm, touch_vector new_force_n,
                                    touch_vector new_torque_nm) {
    seam->left_s = TOUCH_BLEND_S;
    seam->force_n = touch_subtract(force_n, new_force_n);
    seam->torque_nm = touch_subtract(torque_nm, new_torque_nm);
    seam->max_n = touch_norm(force_n);
    seam->max_nm = touch_norm(torque_nm);
}

/* A force after a seam with what is left of that before; a torque, too. */
static inline touch_vector touch_faded(const touch_seam *seam, touch_vector force, touch_vector more, double max_before) {
    double weight = touch_fade_weight(seam->left_s);
    double limit = touch_fmax(max_before, touch_norm(force));
    touch_vector sum = touch_add_scaled(force, weight, more);
    double size = touch_norm(sum);
    return size > limit ? touch_scale(limit / size, sum) : sum;
}

typedef struct { /* what a seam needs of the tick before */
    int is_starting;
    touch_vector force_n, torque_nm; /* desired */
} touch_force_before;

/* From the first tick after a seam on, friction depends on how hard the hand was pressed before, too. `before_n`: in the
   device's axes. */
static inline void touch_start_pressing(touch_receiver *receiver, touch_vector before_n) {
    const touch_settings *settings = &receiver->settings;
    touch_seam *seam = &receiver->state.seam;
    seam->left_s = TOUCH_BLEND_S;
    seam->pressed_n = touch_norm(touch_subtract(before_n, settings->gravity_n)) / settings->force_scale;
}

/* Before the force of a tick: in the first one after a seam, the force of the tick before goes on with the motion of the hand,
   and proxy and anchor stay in place. `t` is NULL while frames are still to come. */
static inline touch_force_before touch_enter_seam(touch_receiver *receiver, const touch_instant *t) {
    touch_tick_state *state = &receiver->state;
    touch_seam *seam = &state->seam;
    touch_force_before before;
    before.is_starting = seam->is_starting || (seam->is_field_missing != !t);
    before.force_n = state->force.desired, before.torque_nm = state->torque.desired;
    if (!t || !before.is_starting) return before;
    before.force_n = touch_add(before.force_n, touch_motion_change(receiver, t));
    touch_stay_in_place(receiver, t);
    if (!receiver->layout.is_unblended) touch_start_pressing(receiver, before.force_n);
    return before;
}

/* The force of a tick, N, and the torque, in state.torque.desired, with what is left of those before a seam. */
static inline touch_vector touch_fade_over_seam(touch_receiver *receiver, const touch_instant *t, touch_force_before before,
                                                touch_vector force_n, double dt_s) {
    touch_tick_state *state = &receiver->state;
    touch_seam *seam = &state->seam;
    if (before.is_starting && !receiver->layout.is_unblended)
        touch_start_fade(seam, before.force_n, before.torque_nm, force_n, state->torque.desired);
    seam->is_starting = 0, seam->is_field_missing = !t, seam->hand_m = state->position_m;
    if (!(seam->left_s > 0.0)) return force_n;
    state->torque.desired = touch_faded(seam, state->torque.desired, seam->torque_nm, seam->max_nm);
    force_n = touch_faded(seam, force_n, seam->force_n, seam->max_n);
    seam->left_s = touch_fmax(0.0, seam->left_s - dt_s);
    return force_n;
}

#endif
