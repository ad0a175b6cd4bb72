/* touch_render.h: one tick of the servo, from the position of the device to a limited force: what updateFromDevice,
   computeInteractionForces and applyToDevice of a tool of CHAI3D do. Nothing is allocated, and nothing waits.

       touch_receiver *receiver = memory;   // laid out as touch_receiver.h says, with settings, frames and a first order
       while (!receiver->clock.is_released) {
           wait until receiver->clock.deadline_ns;
           touch_vector force_n = touch_receiver_tick(receiver, position of the device, m, now_ns);
           put force_n, and receiver->state.torque.output, N m, out to the device;
       }

   Another thread, or another process that shares the memory, decodes: it writes a frame into the arena, shows it with
   touch_publish, and plays, pauses, seeks and stops with touch_give_order. It need not wait for the servo, nor the servo
   for it; clock.needs tells which frames it may overwrite.

   One tick, call by call. The sections of this file are in this order; within a section a function stands behind those that it
   calls, so that touch_receiver_tick and touch_tick are the last ones of theirs. Read them first:

       touch_receiver_tick             all of it, at a time of the clock
           touch_count_silence         whether the player, and the thread that decodes, give a sign of life
           touch_count_time            jitter, missed ticks, the next deadline
           touch_take_order            play, pause, seek, stop
           touch_find_frames           media clock; the two frames around now, and how far between them (an instant)
               touch_find_seam             where the medium does not go on from one to the other      touch_seam.h
           touch_tick                  the force:
               touch_store_past_force      for the passivity observer
               touch_move_device           device to field: axes, scale, clutch; passivity observer; velocity
                   touch_smooth_settings       damper in contact and coupling, on their way to the settings     touch_effects.h
               touch_force_over_seam       the desired force; after a seam with what is left of that before it
               touch_desired_force
                   touch_find_material         the material there, if there are any                 touch_effects.h
                   touch_field_force           one of four:
                       touch_contact_force         proxy (god object)                         touch_proxy.h
                       touch_tool_force            penalty forces on the points of a tool     touch_tool.h
                       touch_coupling_force        virtual coupling                           touch_effects.h
                       touch_force_at              penalty force at the point                 touch_query.h
                       touch_yield                 creep of a deformed medium, without a proxy         touch_query.h
                       touch_friction_force        dry friction at the proxy or the hand              touch_friction.h
                   touch_vibration_force, touch_texture, touch_damped         touch_effects.h
                   touch_passivity_controller                                                 touch_effects.h
                   gravity                     the weight of the handle
               ramp                        a gain of 0 to 1, in the time of the settings
               touch_limit_both            cap (the peak, lowered by heat), then slew         touch_effects.h
           touch_release               in place of touch_tick after a stop: the next force on the way to zero
           touch_write_row             the log

   Two frames of reference: "device" is the axes of the device, metres of the workspace; "field" is that of the medium. Only
   touch_tick and touch_release put forces out, and both do so through touch_limit_both, or repeat the last force where no time
   has passed. Without a frame, a position or an orientation of the device the gain goes to zero in the time of the ramp, and
   so does the last force.

   The media clock stands at the beginning and after a seek until the first frames are there. Where a later one is late there
   is no force, but the clock goes on; only where nothing more will come does it stand. A paused medium keeps its force. */
#ifndef TOUCH_RENDER_H
#define TOUCH_RENDER_H

#include "touch_effects.h"
#include "touch_friction.h"
#include "touch_proxy.h"
#include "touch_seam.h"
#include "touch_shared.h"
#include "touch_tool.h"

static inline int64_t touch_tag(int64_t generation, int64_t unrolled_frame) {
    return (int64_t)((uint64_t)generation << TOUCH_FRAME_BITS) | unrolled_frame;
}

static inline touch_directory_entry *touch_slot_of(touch_receiver *receiver, int64_t unrolled_frame) {
    touch_directory_entry *entries = (touch_directory_entry *)((char *)receiver + receiver->layout.directory_offset);
    return entries + (unrolled_frame & (receiver->layout.directory_slots - 1));
}

/* -- a tick of the servo ---------------------------------------------------------------------------------------------- */

/* A player, or a thread that decodes, that gave no sign of life for so long is taken for dead, and the force goes to zero. */
#define TOUCH_MAX_SILENCE_NS INT64_C(1000000000)
#define TOUCH_MAX_SILENT_STEP_NS INT64_C(100000000) /* more between two ticks was a pause of the servo's own */

typedef struct { /* the frames of an instant, by their offsets from the first byte of the receiver */
    int64_t before_offset, after_offset; /* 0: there is none, hence no force */
    double blend;
    int64_t first_frame; /* the first one that may still be read */
} touch_frames;

static inline int touch_count_silence(touch_receiver *receiver, int64_t now_ns);
static inline void touch_count_time(touch_receiver *receiver, int64_t now_ns);
static inline void touch_take_order(touch_receiver *receiver, double clock_s);
static inline touch_frames touch_find_frames(touch_receiver *receiver, double clock_s, int is_silent);
static inline touch_vector touch_tick(touch_receiver *receiver, int64_t before_offset, int64_t after_offset, double blend,
                                      touch_vector device_m, double dt_s);
static inline touch_vector touch_release(touch_receiver *receiver, double dt_s);
static inline int64_t touch_flags(const touch_clock *clock, int is_silent, int is_stopping);
static inline void touch_write_row(touch_receiver *receiver, double clock_s, touch_vector force_n, int64_t flags);

static inline int touch_is_zero(touch_vector v) { return v.x == 0.0 && v.y == 0.0 && v.z == 0.0; }

/* The force, N, in the device's axes, for a device at `device_m`, at `now_ns` of a clock that never goes back. The torque,
   N m, is in state.torque.output. What the grip reports is to be in `grip` before. */
static inline touch_vector touch_receiver_tick(touch_receiver *receiver, touch_vector device_m, int64_t now_ns) {
    touch_clock *clock = &receiver->clock;
    int64_t ticks = receiver->counts.ticks;
    double dt_s = 1.0 / receiver->settings.rate_hz;
    double clock_s = (double)ticks / receiver->settings.rate_hz;
    int is_silent = touch_count_silence(receiver, now_ns);
    touch_count_time(receiver, now_ns);
    if (!receiver->layout.is_simulated) {
        clock_s = 1e-9 * (double)(now_ns - receiver->counts.first_ns);
        if (ticks) dt_s = touch_fmax(clock_s - clock->clock_s, 0.0);
    }
    clock->clock_s = clock_s;

    touch_take_order(receiver, clock_s);
    int is_stopping = clock->is_stop_ordered || touch_shared(&clock->is_stopping);
    touch_frames frames = touch_find_frames(receiver, clock_s, is_silent);

    touch_vector force;
    if (is_stopping)
        force = touch_release(receiver, dt_s);
    else
        force = touch_tick(receiver, frames.before_offset, frames.after_offset, frames.blend, device_m, dt_s);
    int is_zero = touch_is_zero(force) && touch_is_zero(receiver->state.torque.output);

    touch_write_row(receiver, clock_s, force, touch_flags(clock, is_silent, is_stopping));
    TOUCH_FENCE();
    touch_share(&clock->needs, touch_tag(clock->generation, frames.first_frame));
    touch_share(&clock->is_resting, is_zero);
    if (is_stopping && is_zero) touch_share(&clock->is_released, 1);
    return force;
}

/* -- time: signs of life, periods and deadlines ----------------------------------------------------------------------- */

/* How long the thread that decodes has given no sign of life at `now_ns`. It needs no clock: a number that it raises. In
   simulated time nobody looks. */
static inline int64_t touch_feed_silence_ns(const touch_receiver *receiver, int64_t now_ns) {
    const touch_clock *clock = &receiver->clock;
    int64_t heartbeat = touch_shared(&receiver->orders.feed_heartbeat), step_ns = now_ns - receiver->counts.last_ns;
    if (heartbeat == 0 || heartbeat != clock->feed_heartbeat_seen || receiver->layout.is_simulated) return 0;
    return clock->feed_silence_ns + (step_ns < TOUCH_MAX_SILENT_STEP_NS ? step_ns : TOUCH_MAX_SILENT_STEP_NS);
}

/* Whether the player, or the thread that decodes, is taken for dead. */
static inline int touch_count_silence(touch_receiver *receiver, int64_t now_ns) {
    touch_clock *clock = &receiver->clock;
    int64_t heartbeat_ns = touch_shared(&receiver->orders.heartbeat_ns);
    clock->feed_silence_ns = touch_feed_silence_ns(receiver, now_ns);
    clock->feed_heartbeat_seen = touch_shared(&receiver->orders.feed_heartbeat);
    int is_player_silent = heartbeat_ns != 0 && now_ns - heartbeat_ns > TOUCH_MAX_SILENCE_NS;
    int is_silent = is_player_silent || clock->feed_silence_ns > TOUCH_MAX_SILENCE_NS;
    receiver->counts.silences += is_silent && !clock->is_silent;
    receiver->counts.silent_ticks += is_silent;
    touch_share(&clock->is_silent, is_silent);
    return is_silent;
}

static inline int64_t touch_bin(int64_t ns) {
    int64_t us = ns / 1000;
    return us < TOUCH_TIME_BINS ? us : (int64_t)TOUCH_TIME_BINS;
}

/* Count jitter and lateness of this tick, and set the deadline of the next. */
static inline void touch_count_time(touch_receiver *receiver, int64_t now_ns) {
    touch_clock *clock = &receiver->clock;
    touch_counts *counts = &receiver->counts;
    int64_t tick_ns = receiver->layout.tick_ns;
    if (counts->ticks == 0) {
        counts->first_ns = clock->deadline_ns = now_ns;
    } else {
        int64_t jitter = now_ns - counts->last_ns - tick_ns;
        if (jitter < 0) jitter = -jitter;
        counts->periods[touch_bin(jitter)]++;
        if (jitter > counts->worst_period_ns) counts->worst_period_ns = jitter;
    }
    int64_t lateness = now_ns > clock->deadline_ns ? now_ns - clock->deadline_ns : 0;
    counts->latenesses[touch_bin(lateness)]++;
    if (lateness > counts->worst_lateness_ns) counts->worst_lateness_ns = lateness;
    if (2 * lateness > tick_ns) counts->late++;
    int64_t following = (receiver->layout.is_paced ? now_ns : clock->deadline_ns) + tick_ns;
    if (following <= now_ns && tick_ns > 0) { /* what is past is past: no burst of ticks to catch up */
        int64_t missed = (now_ns - following) / tick_ns + 1;
        counts->missed += missed;
        following += missed * tick_ns;
    }
    clock->deadline_ns = following;
    touch_share(&counts->last_ns, now_ns);
    touch_share(&counts->ticks, counts->ticks + 1);
}

/* -- the player: orders and frames ------------------------------------------------------------------------------------ */

/* Write one order of the player; the servo takes it whole or not yet. A stop stays: the servo may see the last of two orders
   only. */
static inline void touch_give_order(touch_receiver *receiver, int64_t generation, double start_s, double speed, int64_t mode,
                                    int64_t is_stopping) {
    touch_orders *orders = &receiver->orders;
    touch_share(&orders->sequence, orders->sequence + 1);
    TOUCH_FENCE();
    touch_share(&orders->generation, generation);
    touch_share_double(&orders->start_s, start_s);
    touch_share_double(&orders->speed, speed);
    touch_share(&orders->mode, mode);
    touch_share(&orders->is_stopping, orders->is_stopping || is_stopping);
    TOUCH_FENCE();
    touch_share(&orders->sequence, orders->sequence + 1);
}

/* Show an unrolled frame that is written at an offset. */
static inline void touch_publish(touch_receiver *receiver, int64_t generation, int64_t unrolled_frame, int64_t frame_offset) {
    touch_directory_entry *entry = touch_slot_of(receiver, unrolled_frame);
    touch_share(&entry->tag, -1);
    TOUCH_FENCE();
    touch_share(&entry->frame_offset, frame_offset);
    TOUCH_FENCE();
    touch_share(&entry->tag, touch_tag(generation, unrolled_frame));
}

/* -- the media clock, and its frames ---------------------------------------------------------------------------------- */

/* Of a frame's number: a time that was meant to be a frame's own is that frame, and not the end of the one before. */
#define TOUCH_FRAME_ROUNDING 1e-6

/* The frame that is shown at a media time. */
static inline int64_t touch_unrolled_frame(double media_s, double rate_hz) {
    return (int64_t)floor(media_s * rate_hz + TOUCH_FRAME_ROUNDING);
}

static inline double touch_media_time(const touch_clock *clock, double clock_s) {
    if (clock->mode == TOUCH_PLAYING && (clock->feed == TOUCH_RUNNING || clock->feed == TOUCH_STALLED))
        return clock->anchor_media_s + (clock_s - clock->anchor_clock_s) * clock->speed;
    return clock->media_s;
}

/* From now on the media time is counted from here. */
static inline void touch_anchor(touch_clock *clock, double media_s, double clock_s) {
    clock->anchor_media_s = media_s;
    clock->anchor_clock_s = clock_s;
}

/* The latest order of the player; 0: it is being written, and will be complete later. */
static inline int touch_read_orders(const touch_receiver *receiver, touch_orders *out) {
    const touch_orders *orders = &receiver->orders;
    out->sequence = touch_shared(&orders->sequence);
    TOUCH_FENCE();
    out->generation = touch_shared(&orders->generation);
    out->start_s = touch_shared_double(&orders->start_s);
    out->speed = touch_shared_double(&orders->speed);
    out->mode = touch_shared(&orders->mode);
    out->is_stopping = touch_shared(&orders->is_stopping);
    TOUCH_FENCE();
    return !(out->sequence & 1) && touch_shared(&orders->sequence) == out->sequence;
}

/* Take the latest order of the player, if it is complete and new. */
static inline void touch_take_order(touch_receiver *receiver, double clock_s) {
    touch_clock *clock = &receiver->clock;
    touch_orders orders;
    if (!touch_read_orders(receiver, &orders) || orders.sequence == clock->sequence_seen) return;
    double media_s = touch_media_time(clock, clock_s);
    if (orders.generation != clock->generation) {
        clock->generation = orders.generation;
        touch_share(&clock->feed, TOUCH_READY);
        media_s = orders.start_s;
    } else if (orders.mode != clock->mode && clock->feed != TOUCH_ENDED) {
        touch_share(&clock->feed, TOUCH_READY);
    }
    touch_share_double(&clock->media_s, media_s);
    touch_anchor(clock, media_s, clock_s);
    touch_share_double(&clock->speed, orders.speed);
    touch_share(&clock->mode, orders.mode);
    clock->is_stop_ordered |= orders.is_stopping != 0; /* for ever */
    TOUCH_FENCE();
    touch_share(&clock->sequence_seen, orders.sequence); /* last: who sees it sees no state of the order before */
}

/* Where an unrolled frame lies; 0 if it is not there. */
static inline int64_t touch_frame_offset(touch_receiver *receiver, int64_t unrolled_frame) {
    const touch_directory_entry *entry = touch_slot_of(receiver, unrolled_frame);
    if (touch_shared(&entry->tag) != touch_tag(receiver->clock.generation, unrolled_frame)) return 0;
    TOUCH_FENCE();
    return touch_shared(&entry->frame_offset);
}

/* The media clock runs again: these frames are there. Those that come after a seek, or late, begin with a seam. */
static inline void touch_use_frames(touch_receiver *receiver, double media_s, double clock_s, int64_t unrolled_frame) {
    touch_clock *clock = &receiver->clock;
    if (clock->used >> TOUCH_FRAME_BITS != clock->generation || clock->feed == TOUCH_STALLED)
        receiver->state.seam.is_starting = 1;
    if (clock->mode == TOUCH_PLAYING && clock->feed != TOUCH_RUNNING) {
        touch_anchor(clock, media_s, clock_s);
        touch_share(&clock->feed, TOUCH_RUNNING);
    }
    int64_t tag = touch_tag(clock->generation, unrolled_frame);
    if (tag != clock->used) {
        clock->used = tag;
        receiver->counts.frames_used++;
    }
}

/* Frames are missing, or the player is silent: count that. Where nothing more will come, the media clock stands at
   `standing_s`. */
static inline void touch_wait_for_frames(touch_receiver *receiver, double standing_s, double clock_s, int is_silent) {
    touch_clock *clock = &receiver->clock;
    touch_counts *counts = &receiver->counts;
    int is_over = is_silent || touch_shared(&receiver->orders.has_feed_failed); /* no frame will come */
    if (clock->mode != TOUCH_PLAYING) return;
    if (clock->feed == TOUCH_RUNNING) {
        touch_share(&clock->feed, TOUCH_STALLED);
        counts->underruns += !is_over;
    } else if (clock->feed == TOUCH_READY) {
        touch_share(&clock->feed, TOUCH_WAITING);
        counts->waits++;
    }
    if (clock->feed == TOUCH_STALLED)
        counts->stalled_ticks++;
    else
        counts->waiting_ticks++;
    if (is_over) {
        touch_share_double(&clock->media_s, standing_s);
        touch_anchor(clock, standing_s, clock_s);
    }
}

/* Whether an unrolled frame need not go on from the one before. */
static inline int touch_is_seam(const touch_receiver *receiver, int64_t frame, int64_t frame_offset) {
    const touch_receiver_layout *layout = &receiver->layout;
    const char *memory = (const char *)receiver;
    if (layout->is_loop && frame % layout->frame_count == 0) return 1;
    return ((const touch_frame_header *)(const void *)(memory + frame_offset))->is_seam != 0;
}

/* Where the medium jumps to the frame after, show the frame before until then. Whether it jumps is found out in the first tick
   between the two, when the frame before them is still there: clock.needs has not passed it. */
static inline void touch_find_seam(touch_receiver *receiver, touch_frames *found, int64_t following) {
    touch_seam *seam = &receiver->state.seam;
    int64_t tag = touch_tag(receiver->clock.generation, following);
    if (seam->is_cut && touch_tag(receiver->clock.generation, found->first_frame) >= seam->frame)
        seam->is_cut = 0, seam->is_starting = 1;
    if (following == found->first_frame || !touch_is_seam(receiver, following, found->after_offset)) return;
    if (seam->frame != tag) {
        int64_t former_offset = found->first_frame > 0 ? touch_frame_offset(receiver, found->first_frame - 1) : 0;
        if (!former_offset) former_offset = found->before_offset;
        touch_instant t = touch_instant_of(receiver, found->before_offset, found->after_offset, 0.5);
        touch_instant own = touch_instant_of(receiver, former_offset, found->before_offset, 0.5);
        seam->frame = tag, seam->is_cut = touch_is_jump(receiver, &t, &own);
    }
    if (seam->is_cut) found->after_offset = found->before_offset, found->blend = 0.0;
}

/* Whether a seek waits for its frames, which are still to come. */
static inline int touch_is_seeking(const touch_receiver *receiver, int is_silent) {
    const touch_clock *clock = &receiver->clock;
    if (is_silent || touch_shared(&receiver->orders.has_feed_failed)) return 0;
    return clock->used >> TOUCH_FRAME_BITS != clock->generation;
}

/* Advance the media clock, and find the two frames of this instant. */
static inline touch_frames touch_find_frames(touch_receiver *receiver, double clock_s, int is_silent) {
    touch_clock *clock = &receiver->clock;
    int64_t count = receiver->layout.frame_count, is_loop = receiver->layout.is_loop, following = 0;
    double rate_hz = receiver->layout.frame_rate_hz;
    double media_s = touch_media_time(clock, clock_s), before_s = clock->media_s;
    touch_frames none = {0, 0, 0.0, 0}, found = none;
    if (count > 1) {
        int64_t frame = none.first_frame = touch_unrolled_frame(media_s, rate_hz);
        if (!is_loop && frame >= count) {
            touch_share_double(&clock->media_s, (double)count / rate_hz);
            touch_share(&clock->feed, TOUCH_ENDED);
            none.first_frame = count;
            return none;
        }
        following = frame == count - 1 && !is_loop ? frame : frame + 1;
        found.blend = touch_clamp(media_s * rate_hz - (double)frame, 0.0, 1.0);
    }
    touch_share_double(&clock->media_s, media_s);
    receiver->state.seam.is_waiting = 0;
    if (clock->mode == TOUCH_PLAYING) receiver->counts.played_ticks++;
    if (clock->mode == TOUCH_IDLE) return none;
    found.first_frame = none.first_frame;
    found.before_offset = touch_frame_offset(receiver, found.first_frame);
    found.after_offset = touch_frame_offset(receiver, following);
    if (!found.before_offset || !found.after_offset || is_silent) {
        touch_wait_for_frames(receiver, before_s, clock_s, is_silent);
        receiver->state.seam.is_waiting = touch_is_seeking(receiver, is_silent);
        return none;
    }
    touch_use_frames(receiver, media_s, clock_s, found.first_frame);
    touch_find_seam(receiver, &found, following);
    return found;
}

/* -- the device: position, orientation, velocity ---------------------------------------------------------------------- */

#define TOUCH_MAX_POSITION_M 1e6           /* what lies farther off is no position of a hand */
#define TOUCH_MAX_TICK_S 60.0              /* a tick that comes later is as good as a first one */
#define TOUCH_MIN_COMPLIANCE_M_PER_N 1e-9  /* 1 / K of the coupling: a stiffer one is none */
#define TOUCH_MIN_ORIENTATION_SQUARE 0.81  /* |q|^2 of a quaternion that was meant to be of length 1 */
#define TOUCH_MAX_ORIENTATION_SQUARE 1.21

/* False also where it is not a number. */
static inline int touch_is_position(touch_vector p) {
    return fabs(p.x) <= TOUCH_MAX_POSITION_M && fabs(p.y) <= TOUCH_MAX_POSITION_M && fabs(p.z) <= TOUCH_MAX_POSITION_M;
}

/* Whether the orientation of the grip is known, if there is a tool; sets that of the tool in the field. */
static inline int touch_orient_tool(touch_receiver *receiver) {
    const double *q = receiver->grip.orientation;
    if (!TOUCH_HAS_EXTRAS || !receiver->settings.tool_point_count) return 1;
    touch_vector v = touch_vector_of(q[1], q[2], q[3]);
    double square = q[0] * q[0] + touch_dot(v, v);
    if (!(square >= TOUCH_MIN_ORIENTATION_SQUARE && square <= TOUCH_MAX_ORIENTATION_SQUARE)) return 0;
    const touch_matrix *axes = &receiver->settings.axes;
    touch_matrix grip = touch_rotation_of(q[0], v), columns;
    for (int n = 0; n < 3; n++) /* axes . grip . axes^T, column by column */
        columns.row[n] = touch_rotate(axes, touch_rotate(&grip, axes->row[n]));
    touch_matrix *rotation = &receiver->state.tool_rotation;
    rotation->row[0] = touch_vector_of(columns.row[0].x, columns.row[1].x, columns.row[2].x);
    rotation->row[1] = touch_vector_of(columns.row[0].y, columns.row[1].y, columns.row[2].y);
    rotation->row[2] = touch_vector_of(columns.row[0].z, columns.row[1].z, columns.row[2].z);
    return 1;
}

/* Take a position of the device: its position and velocity in the field, and the energy of its motion. */
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

/* -- the force that is desired: field, friction, damping, vibration --------------------------------------------------- */

/* The torque before gain and limits, N m, in the device's axes: a lever of the field is `scale` times the device's. */
static inline void touch_desired_torque(touch_receiver *receiver) {
    const touch_settings *settings = &receiver->settings;
    touch_vector torque = receiver->state.field_torque_nm;
    if (!touch_is_finite(torque)) torque = touch_zero();
    double scale = settings->handedness * settings->force_scale / settings->scale;
    receiver->state.torque.desired = touch_scale(scale, touch_rotate_back(&settings->axes, torque));
}

/* The force of the field on the hand, N, in the field's axes, without friction, and what friction adds. By settings: proxy,
   tool, virtual coupling, or the force at the point itself. `*point_m` is the hand; with a virtual coupling it becomes the
   position of the proxy. */
static inline touch_vector touch_field_force(touch_receiver *receiver, const touch_instant *t, touch_vector *point_m,
                                             touch_vector *friction_n, double dt_s) {
    const touch_settings *settings = &receiver->settings;
    touch_tick_state *state = &receiver->state;
    touch_vector force;
    if (settings->wall_n_per_m > 0.0) {
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
    if (!(settings->wall_n_per_m > 0.0)) touch_yield(receiver, t, *point_m, force, dt_s);
    touch_vector stuck = settings->wall_n_per_m > 0.0 ? state->proxy.position_m : *point_m;
    *friction_n = touch_friction_force(receiver, t, stuck, force, dt_s);
    return force;
}

/* Where the vibration of the medium acts: at the hand, or, where the hand is behind a thin wall that has none, at the proxy. */
static inline touch_vector touch_vibrating_point(const touch_receiver *receiver, const touch_instant *t, touch_vector hand_m) {
    const touch_proxy *proxy = &receiver->state.proxy;
    double amplitude, frequency;
    if (!(receiver->settings.wall_n_per_m > 0.0 && proxy->is_active && proxy->is_in_contact)) return hand_m;
    touch_vibration_at(t, hand_m, &amplitude, &frequency);
    return amplitude > 0.0 ? hand_m : proxy->position_m;
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
    state->field_force_n = force;
    state->friction_n = friction;

    double size = touch_norm(force);
    double vibration = touch_vibration_force(receiver, t, touch_vibrating_point(receiver, t, point), dt_s);
    if (material) vibration += touch_texture(receiver, material, force, velocity, dt_s);
    touch_vector added = touch_add_scaled(friction, -settings->damping_n_s_per_m, velocity);
    touch_vector vibration_n = touch_vector_of(0.0, 0.0, vibration); /* along the force; upwards where there is none */
    if (size > 0.0)
        vibration_n = touch_vector_of(force.x / size * vibration, force.y / size * vibration, force.z / size * vibration);
    added = touch_add(added, vibration_n);
    force = touch_add(touch_damped(state, force, velocity), added);

    /* from the field's axes into the device's */
    force = touch_scale(settings->force_scale, touch_rotate_back(&settings->axes, force));
    touch_vector device_velocity = touch_scale(1.0 / settings->scale, touch_rotate_back(&settings->axes, velocity));
    force = touch_passivity_controller(receiver, force, device_velocity, dt_s);
    return touch_add(force, settings->gravity_n);
}

/* The desired force, N, and the torque, in state.torque.desired. `t` is NULL while a seek waits for its frames: a field without
   a force. In the first tick after a seam the force of the tick before goes on, and then fades into that of the field. */
static inline touch_vector touch_force_over_seam(touch_receiver *receiver, const touch_instant *t, double dt_s) {
    touch_tick_state *state = &receiver->state;
    touch_seam *seam = &state->seam;
    touch_vector force_before = state->force.desired, torque_before = state->torque.desired;
    touch_vector force = receiver->settings.gravity_n;
    int is_starting = seam->is_starting || (seam->is_frame_missing != !t);
    state->torque.desired = touch_zero();
    if (t) {
        if (is_starting) {
            force_before = touch_add(force_before, touch_motion_change(receiver, t));
            touch_stay_in_place(receiver, t);
        }
        force = touch_desired_force(receiver, t, dt_s);
    }
    if (is_starting) touch_start_fade(seam, force_before, torque_before, force, state->torque.desired);
    seam->is_frame_missing = !t, seam->hand_m = state->position_m;
    if (!(seam->left_s > 0.0)) return force;
    state->torque.desired = touch_faded(seam, state->torque.desired, seam->torque_nm, seam->max_nm);
    force = touch_faded(seam, force, seam->force_n, seam->max_n);
    seam->left_s = touch_fmax(0.0, seam->left_s - dt_s);
    return force;
}

/* -- the force that is put out: ramp and limits ----------------------------------------------------------------------- */

/* No force and no friction of the field act in this tick. */
static inline void touch_skip_field(touch_tick_state *state) {
    state->field_force_n = state->friction_n = state->field_torque_nm = touch_zero();
}

/* The hand leaves the field: where it was in contact is forgotten. */
static inline void touch_leave_field(touch_tick_state *state) {
    touch_skip_field(state);
    state->proxy.is_active = state->anchor.is_set = 0;
}

/* What was put out fades with the gain; one missing frame or position leaves proxy and anchor where they are. */
static inline void touch_ramp_out(touch_tick_state *state, double gain_step) {
    double before = state->gain;
    state->gain = touch_fmax(0.0, before - gain_step);
    state->seam.is_frame_missing = state->gain > 0.0;
    touch_skip_field(state);
    if (before > 0.0) {
        state->force.desired = touch_scale(1.0 / before, state->force.output);
        state->torque.desired = touch_scale(1.0 / before, state->torque.output);
    }
    if (state->gain > 0.0) return;
    touch_leave_field(state);
    state->force.desired = touch_zero();
}

/* Limit force and torque by peak, heat and slew. The force; the torque is in state.torque.output. */
static inline touch_vector touch_limit_both(touch_receiver *receiver, touch_vector force_n, touch_vector torque_nm,
                                            double dt_s) {
    const touch_settings *settings = &receiver->settings;
    touch_tick_state *state = &receiver->state;
    (void)touch_limit_output(settings, &settings->torque_limits, &state->torque, torque_nm, dt_s);
    return touch_limit_output(settings, &settings->force_limits, &state->force, force_n, dt_s);
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
    int is_pose_known = touch_is_position(device_m) && touch_orient_tool(receiver);
    if (is_pose_known) touch_move_device(receiver, device_m);
    double gain_step = touch_clamped_dt(settings, dt_s) / settings->ramp_s;
    if (before_offset && after_offset && is_pose_known) {
        touch_instant t = touch_instant_of(receiver, before_offset, after_offset, blend);
        double gain = touch_fmin(1.0, state->gain + gain_step);
        state->force.desired = touch_force_over_seam(receiver, &t, dt_s);
        state->gain = gain;
    } else if (state->seam.is_waiting && is_pose_known && state->gain > 0.0) {
        int is_proxy_active = state->proxy.is_active && settings->wall_n_per_m > 0.0; /* on its side of a wall until then */
        touch_leave_field(state);
        state->proxy.is_active = is_proxy_active;
        state->force.desired = touch_force_over_seam(receiver, NULL, dt_s);
        if (state->seam.left_s == 0.0) state->gain = 0.0;
    } else {
        touch_ramp_out(state, gain_step);
    }
    if (state->gain == 0.0) state->torque.desired = touch_zero();
    touch_vector force = touch_scale(state->gain, state->force.desired);
    return touch_limit_both(receiver, force, touch_scale(state->gain, state->torque.desired), dt_s);
}

/* The next force on the way to zero within the ramp or the slew limit, N, in the device's axes; in the end zero for ever. */
static inline touch_vector touch_release(touch_receiver *receiver, double dt_s) {
    const touch_settings *settings = &receiver->settings;
    touch_tick_state *state = &receiver->state;
    if (!touch_is_time_step(settings, dt_s)) return state->force.output;
    double gain = touch_fmax(0.0, state->gain - touch_clamped_dt(settings, dt_s) / settings->ramp_s);
    double fraction = gain > 0.0 ? gain / state->gain : 0.0;
    state->gain = gain;
    state->is_started = 0;
    touch_leave_field(state);
    state->force.desired = state->torque.desired = touch_zero();
    touch_vector force = touch_scale(fraction, state->force.output);
    return touch_limit_both(receiver, force, touch_scale(fraction, state->torque.output), dt_s);
}

/* -- the log ---------------------------------------------------------------------------------------------------------- */

static inline int64_t touch_flags(const touch_clock *clock, int is_silent, int is_stopping) {
    static const int64_t feed_flags[] = {0, TOUCH_FLAG_WAITING, TOUCH_FLAG_RUNNING, TOUCH_FLAG_STALLED, TOUCH_FLAG_ENDED};
    int64_t flags = clock->feed >= TOUCH_READY && clock->feed <= TOUCH_ENDED ? feed_flags[clock->feed] : 0;
    if (is_stopping) flags |= TOUCH_FLAG_STOPPING;
    if (is_silent) flags |= TOUCH_FLAG_SILENT;
    if (clock->mode == TOUCH_PAUSED) flags |= TOUCH_FLAG_PAUSED;
    return flags;
}

static inline void touch_write_row(touch_receiver *receiver, double clock_s, touch_vector force_n, int64_t flags) {
    const touch_tick_state *state = &receiver->state;
    const touch_receiver_layout *layout = &receiver->layout;
    if (layout->log_rows <= 0) return;
    touch_log_row *rows = (touch_log_row *)((char *)receiver + layout->log_offset);
    touch_log_row *row = rows + receiver->clock.log_written % layout->log_rows;
    row->time_s = clock_s;
    row->media_s = receiver->clock.media_s;
    row->position_m = state->position_m;
    row->velocity_m_s = state->velocity_m_s;
    row->field_force_n = state->field_force_n;
    row->friction_n = state->friction_n;
    row->force_n = force_n;
    row->flags = flags;
    for (int n = 0; n < 4; n++) row->orientation[n] = receiver->grip.orientation[n];
    row->field_torque_nm = state->field_torque_nm;
    row->torque_nm = state->torque.output;
    row->buttons = receiver->grip.buttons;
    row->gripper_m = receiver->grip.gripper_m;
    TOUCH_FENCE();
    touch_share(&receiver->clock.log_written, receiver->clock.log_written + 1);
}

#endif
