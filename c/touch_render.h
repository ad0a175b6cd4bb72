/* touch_render.h: one tick of the servo, from the position of the device to a limited force: what updateFromDevice,
   computeInteractionForces and applyToDevice of a tool of CHAI3D do. Nothing is allocated, and nothing waits.

       touch_receiver *receiver = memory;   // laid out as touch_receiver.h says, with settings, frames and a first order
       while (!receiver->clock.is_released) {
           wait until receiver->clock.deadline_ns;
           receiver->grip = what the device reports besides;
           touch_vector force_n = touch_receiver_tick(receiver, position of the device, m, now_ns);
           put force_n, and receiver->state.torque.output, N m, out to the device;
       }

   Read this file from top to bottom: a function stands before those that it calls. One tick, call by call:

       touch_receiver_tick             all of it; TOUCH_FENCE, touch_share and touch_shared           touch_shared.h
           touch_count_silence             does the player, and the thread that decodes, still live?      touch_timing.h
           touch_count_time                jitter, missed ticks, the next deadline                        touch_timing.h
           touch_take_order                play, pause, seek, stop                                        touch_media_clock.h
           touch_find_frames               the two frames around now, and how far between them            touch_media_clock.h
           touch_tick                      the force:
               touch_store_past_force          for passivity                                              touch_effects.h
               touch_orient_tool               orientation of a tool                                      touch_tool.h
               touch_move_device               device to field: axes, scale, clutch
                   touch_passivity_observer        the energy that the hand put in                        touch_effects.h
                   touch_update_velocity           low-passed                                             touch_effects.h
                   touch_smooth_settings           brake and coupling, on their way to the settings       touch_effects.h
               touch_force_over_seam           the force; after a jump of the medium what changed fades out:
                   touch_enter_seam                what goes on from the tick before                      touch_seam.h
                   touch_desired_force             the force of the field, and what is added to it:
                       touch_find_material         the material there, if there are any, and mu           touch_effects.h
                       touch_field_force           one of these four; then yield and friction:
                           touch_contact_force         proxy (god object)                                 touch_proxy.h
                           touch_tool_force            penalty forces on the points of a tool             touch_tool.h
                           touch_coupling_force        virtual coupling                                   touch_effects.h
                           touch_force_at              penalty force at the point                         touch_query.h
                           touch_yield                 a deformed medium gives way, if there is no proxy  touch_query.h
                           touch_friction_force        dry friction                                       touch_friction.h
                       touch_vibration_force, touch_texture, touch_braked                                 touch_effects.h
                       touch_passivity_controller                                                         touch_effects.h
                   touch_fade_over_seam            what is left of the force before                       touch_seam.h
               touch_fade_out                  or, while frames are still to come: the force before fades
               touch_ramp_out                  or, without a frame or a position: it ramps down
               touch_limit_both                after the ramp's gain: the peak, lowered by heat; then slew
           touch_release                   in place of touch_tick after a stop: the next force on the way to zero
           touch_write_row                 the log                                                        touch_log.h

   Two frames of reference: "device" is the axes of the device, metres of the workspace; "field" is that of the medium.

   Only touch_tick and touch_release put forces out. Both do so through touch_limit_both, or repeat the last force where no
   time has passed. Without a frame, a position or an orientation of the device, the last force ramps down; where that is
   because frames of a seek, or late ones, are still to come, it fades instead. */
#ifndef TOUCH_RENDER_H
#define TOUCH_RENDER_H

#include "touch_effects.h"
#include "touch_friction.h"
#include "touch_log.h"
#include "touch_media_clock.h"
#include "touch_proxy.h"
#include "touch_seam.h"
#include "touch_timing.h"
#include "touch_tool.h"

static inline touch_vector touch_tick(touch_receiver *receiver, int64_t before_offset, int64_t after_offset, double blend,
                                      touch_vector device_m, double dt_s);
static inline touch_vector touch_release(touch_receiver *receiver, double dt_s);
static inline int touch_is_position(touch_vector p);
static inline void touch_move_device(touch_receiver *receiver, touch_vector device_m);
static inline touch_vector touch_force_over_seam(touch_receiver *receiver, const touch_instant *t, double dt_s);
static inline void touch_fade_out(touch_receiver *receiver, double dt_s);
static inline touch_vector touch_desired_force(touch_receiver *receiver, const touch_instant *t, double dt_s);
static inline touch_vector touch_field_force(touch_receiver *receiver, const touch_instant *t, touch_vector *point_m,
                                             touch_vector *friction_n, double dt_s);
static inline void touch_desired_torque(touch_receiver *receiver);
static inline void touch_ramp_out(touch_receiver *receiver, double gain_step, int is_pose_known);
static inline void touch_ramp_down(touch_tick_state *state, double gain_step);
static inline void touch_leave_field(touch_tick_state *state, int is_proxy_kept);
static inline void touch_skip_field(touch_tick_state *state);
static inline touch_vector touch_limit_both(touch_receiver *receiver, double dt_s);

#define TOUCH_MAX_TICK_S 60.0 /* a longer dt counts as this */

/* -- a tick ----------------------------------------------------------------------------------------------------------- */

/* The force, N, in the device's axes, for a device at `device_m`, at `now_ns` of a clock that never goes back. The torque,
   N m, is in state.torque.output. */
static inline touch_vector touch_receiver_tick(touch_receiver *receiver, touch_vector device_m, int64_t now_ns) {
    touch_clock *clock = &receiver->clock;
    int64_t ticks = receiver->counts.ticks;
    int is_silent = touch_count_silence(receiver, now_ns);
    touch_count_time(receiver, now_ns); /* counts this tick; the two lines above need the state before it */
    double clock_s = 1e-9 * (double)(now_ns - receiver->counts.first_ns);
    double dt_s = ticks ? touch_fmax(clock_s - clock->clock_s, 0.0) : 1.0 / receiver->settings.rate_hz;
    if (receiver->layout.is_simulated) {
        clock_s = (double)ticks / receiver->settings.rate_hz;
        dt_s = 1.0 / receiver->settings.rate_hz;
    }
    clock->clock_s = clock_s;

    touch_take_order(receiver, clock_s);
    int is_stopping = clock->is_stop_ordered || touch_shared(&clock->is_stopping); /* by the player, or by the servo itself */
    touch_frames frames = touch_find_frames(receiver, clock_s, is_silent);

    touch_vector force;
    if (is_stopping)
        force = touch_release(receiver, dt_s);
    else
        force = touch_tick(receiver, frames.before_offset, frames.after_offset, frames.blend, device_m, dt_s);
    int is_zero = touch_is_zero(force) && touch_is_zero(receiver->state.torque.output);

    touch_write_row(receiver, clock_s, force, touch_flags(clock, is_silent, is_stopping));
    TOUCH_FENCE();
    touch_share(&clock->needs, touch_tag(clock->generation, frames.first_frame)); /* frames before it may be overwritten */
    touch_share(&clock->is_resting, is_zero);
    if (is_stopping && is_zero) touch_share(&clock->is_released, 1);
    return force;
}

/* The force of one tick, N, in the device's axes, for a device at `device_m`. The torque is in state.torque.output.

   The offsets are those of the frames before and after this time, 0: there is none; `blend` goes from the one to the other.
   A `dt_s` that is not positive and finite gives the force before once more. */
static inline touch_vector touch_tick(touch_receiver *receiver, int64_t before_offset, int64_t after_offset, double blend,
                                      touch_vector device_m, double dt_s) {
    const touch_settings *settings = &receiver->settings;
    touch_tick_state *state = &receiver->state;
    if (!touch_is_time_step(settings, dt_s)) return state->force.output;
    dt_s = touch_fmin(dt_s, TOUCH_MAX_TICK_S);
    state->since_s += dt_s;
    touch_store_past_force(receiver);
    int is_tool_known = touch_orient_tool(receiver);
    int is_pose_known = touch_is_position(device_m) && is_tool_known;
    if (is_pose_known) touch_move_device(receiver, device_m);
    double gain_step = touch_clamped_dt(settings, dt_s) / settings->ramp_s;
    state->seam.late_s = before_offset && after_offset ? 0.0 : state->seam.late_s + dt_s;
    if (before_offset && after_offset && is_pose_known) { /* the desired force, and after a seam what is left of that before */
        touch_instant t = touch_instant_of(receiver, before_offset, after_offset, blend);
        double gain = touch_fmin(1.0, state->gain + gain_step);
        state->force.desired = touch_force_over_seam(receiver, &t, dt_s);
        state->gain = gain; /* only now: touch_force_over_seam needs that of the tick before */
    } else if (is_pose_known && touch_is_fading_out(receiver)) {
        touch_fade_out(receiver, dt_s);
    } else {
        touch_ramp_out(receiver, gain_step, is_pose_known);
    }
    return touch_limit_both(receiver, dt_s);
}

/* The next force on the way to zero within the ramp or the slew limit, N, in the device's axes; in the end zero for ever. */
static inline touch_vector touch_release(touch_receiver *receiver, double dt_s) {
    const touch_settings *settings = &receiver->settings;
    touch_tick_state *state = &receiver->state;
    if (!touch_is_time_step(settings, dt_s)) return state->force.output;
    touch_ramp_down(state, touch_clamped_dt(settings, dt_s) / settings->ramp_s);
    touch_leave_field(state, 0);
    state->is_started = 0;
    return touch_limit_both(receiver, dt_s);
}

/* -- the device ------------------------------------------------------------------------------------------------------- */

#define TOUCH_MAX_POSITION_M 1e6 /* what lies farther off is no position of a hand */

/* False also where it is not a number. */
static inline int touch_is_position(touch_vector p) {
    return fabs(p.x) <= TOUCH_MAX_POSITION_M && fabs(p.y) <= TOUCH_MAX_POSITION_M && fabs(p.z) <= TOUCH_MAX_POSITION_M;
}

/* Take a position of the device: its position and velocity in the field, and its work against the forces before. */
static inline void touch_move_device(touch_receiver *receiver, touch_vector device_m) {
    const touch_settings *settings = &receiver->settings;
    touch_tick_state *state = &receiver->state;
    touch_vector rotated = touch_rotate(&settings->axes, device_m);
    touch_vector position = touch_add_scaled(settings->clutch_m, settings->scale, rotated);
    if (state->is_started) {
        touch_passivity_observer(receiver, touch_subtract(device_m, state->device_m));
        touch_update_velocity(receiver, touch_subtract(position, state->position_m), state->since_s);
    } else {
        state->velocity_m_s = touch_zero();
    }
    touch_smooth_settings(receiver);
    state->is_started = 1;
    state->since_s = 0.0;
    state->device_m = device_m;
    state->position_m = position;
}

/* -- the force that is desired ---------------------------------------------------------------------------------------- */

/* Frames are still to come: the force before fades in TOUCH_BLEND_S, to that which carries the handle. */
static inline void touch_fade_out(touch_receiver *receiver, double dt_s) {
    touch_tick_state *state = &receiver->state;
    touch_leave_field(state, touch_is_proxy_kept(receiver));
    state->force.desired = touch_force_over_seam(receiver, NULL, dt_s);
    if (state->seam.left_s == 0.0) state->gain = 0.0; /* without what carries the handle; frames ramp up again */
}

/* The desired force, N, and the torque, in state.torque.desired; after a seam of the medium with what is left of those before
   (touch_seam.h). `t` is NULL while frames are still to come: a field without a force. */
static inline touch_vector touch_force_over_seam(touch_receiver *receiver, const touch_instant *t, double dt_s) {
    touch_force_before before = touch_enter_seam(receiver, t);
    receiver->state.torque.desired = touch_zero(); /* until touch_desired_torque */
    touch_vector force = t ? touch_desired_force(receiver, t, dt_s) : receiver->settings.gravity_n;
    return touch_fade_over_seam(receiver, t, before, force, dt_s);
}

/* The force before gain and limits, N, in the device's axes: that of the field with friction, damping and vibration, as far
   as the passivity controller lets it, and what carries the weight of the handle. */
static inline touch_vector touch_desired_force(touch_receiver *receiver, const touch_instant *t, double dt_s) {
    const touch_settings *settings = &receiver->settings;
    touch_tick_state *state = &receiver->state;
    touch_vector point = state->position_m, velocity = state->velocity_m_s, friction;
    const touch_material *material = NULL;
    if (TOUCH_HAS_EXTRAS && settings->material_count > 0) material = touch_find_material(receiver, t, point);
    touch_vector force = touch_field_force(receiver, t, &point, &friction, dt_s);
    state->field_force_n = force; /* for the log */
    state->friction_n = friction;

    double size = touch_norm(force);
    double vibration = touch_vibration_force(receiver, t, point, dt_s);
    if (material) vibration += touch_texture(receiver, material, force, velocity, dt_s);
    touch_vector added = touch_add_scaled(friction, -settings->damping_n_s_per_m, velocity);
    added = touch_add(added, touch_proxy_damping_force(receiver));
    touch_vector vibration_n = touch_vector_of(0.0, 0.0, vibration); /* along the force; upwards where there is none */
    if (size > 0.0) vibration_n = touch_scale(vibration, touch_divided(force, size));
    touch_vector pushed_n = touch_add(touch_braked(state, force, velocity, dt_s), added);
    state->proxy.swing.pushed_n = pushed_n;
    force = touch_add(pushed_n, vibration_n);

    /* from the field's axes into the device's */
    force = touch_scale(settings->force_scale, touch_rotate_back(&settings->axes, force));
    touch_vector device_velocity = touch_scale(1.0 / settings->scale, touch_rotate_back(&settings->axes, velocity));
    force = touch_passivity_controller(receiver, force, device_velocity, dt_s);
    return touch_add(force, settings->gravity_n);
}

#define TOUCH_MIN_COMPLIANCE_M_PER_N 1e-9 /* 1 / K of the coupling: a stiffer one is none */

/* The force of the field on the hand, N, in the field's axes, without friction, and what friction adds. By settings: proxy (god
   object), tool, virtual coupling, or the force at the point itself. `*point_m` is the hand; in the third case it becomes the
   other end of the coupling. */
static inline touch_vector touch_field_force(touch_receiver *receiver, const touch_instant *t, touch_vector *point_m,
                                             touch_vector *friction_n, double dt_s) {
    const touch_settings *settings = &receiver->settings;
    touch_tick_state *state = &receiver->state;
    int has_proxy = settings->wall_n_per_m > 0.0;
    touch_vector force;
    if (has_proxy) {
        force = touch_contact_force(receiver, t, *point_m, dt_s);
    } else if (TOUCH_HAS_EXTRAS && settings->tool_point_count > 0) {
        force = touch_tool_force(receiver, t, *point_m, &state->field_torque_nm);
        touch_desired_torque(receiver);
    } else if (state->compliance_m_per_n > TOUCH_MIN_COMPLIANCE_M_PER_N) {
        force = touch_coupling_force(receiver, t, point_m);
    } else {
        force = touch_force_at(t, *point_m);
    }
    if (!touch_is_finite(force)) force = touch_zero();
    if (!has_proxy) touch_yield(receiver, t, *point_m, force, dt_s); /* a proxy needs walls that stay */
    int64_t body = has_proxy ? state->proxy.body : touch_carrying_body(t, *point_m);
    *friction_n = touch_friction_force(receiver, t, *point_m, body, force, dt_s);
    return force;
}

/* The torque before gain and limits, N m, in the device's axes: a lever of the field is `scale` times the device's, and
   mirrored axes turn its sign. */
static inline void touch_desired_torque(touch_receiver *receiver) {
    const touch_settings *settings = &receiver->settings;
    touch_vector torque = receiver->state.field_torque_nm;
    if (!touch_is_finite(torque)) torque = touch_zero();
    double scale = settings->handedness * settings->force_scale / settings->scale;
    receiver->state.torque.desired = touch_scale(scale, touch_rotate_back(&settings->axes, torque));
}

/* -- ramp and limits -------------------------------------------------------------------------------------------------- */

/* Without a frame or a position. While the gain falls, proxy and anchor stay, and a frame that comes back starts a fade. At
   gain 0 they are forgotten; late frames keep the proxy longer (TOUCH_SEAM_KEEP_S), so that no hand gets through a wall. */
static inline void touch_ramp_out(touch_receiver *receiver, double gain_step, int is_pose_known) {
    touch_tick_state *state = &receiver->state;
    touch_ramp_down(state, gain_step);
    state->seam.is_field_missing = state->gain > 0.0;
    if (state->gain > 0.0)
        touch_skip_field(state);
    else
        touch_leave_field(state, is_pose_known && touch_is_proxy_kept(receiver));
}

/* Lower the gain, and let what was put out fall with it. */
static inline void touch_ramp_down(touch_tick_state *state, double gain_step) {
    double before = state->gain;
    state->gain = touch_fmax(0.0, before - gain_step);
    state->force.desired = state->torque.desired = touch_zero();
    if (!(state->gain > 0.0)) return;
    state->force.desired = touch_scale(1.0 / before, state->force.output); /* touch_limit_both multiplies by the gain */
    state->torque.desired = touch_scale(1.0 / before, state->torque.output);
}

/* The hand leaves the field: where it was in contact is forgotten, unless a late frame may bring back the wall of the proxy. */
static inline void touch_leave_field(touch_tick_state *state, int is_proxy_kept) {
    touch_skip_field(state);
    state->anchor.is_set = 0;
    state->proxy.is_active = is_proxy_kept;
}

/* No force and no friction of the field act in this tick, nor stand in the log. */
static inline void touch_skip_field(touch_tick_state *state) {
    state->field_force_n = state->friction_n = state->field_torque_nm = touch_zero();
    touch_start_swing(&state->proxy.swing); /* it would take the time without a field for one tick */
}

/* The desired force and torque, times the gain, limited by peak, heat and slew. The force; the torque is in
   state.torque.output. */
static inline touch_vector touch_limit_both(touch_receiver *receiver, double dt_s) {
    const touch_settings *settings = &receiver->settings;
    touch_tick_state *state = &receiver->state;
    touch_vector force = touch_scale(state->gain, state->force.desired);
    touch_vector torque = touch_scale(state->gain, state->torque.desired);
    (void)touch_limit_output(settings, &settings->torque_limits, &state->torque, torque, dt_s);
    return touch_limit_output(settings, &settings->force_limits, &state->force, force, dt_s);
}

#endif
