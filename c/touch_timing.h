/* touch_timing.h: the time of a tick. Does the player, and the thread that decodes, still live; how punctual is the servo; when
   is its next tick due. */
#ifndef TOUCH_TIMING_H
#define TOUCH_TIMING_H

#include "touch_receiver.h"
#include "touch_shared.h"

/* A player, or a thread that decodes, that gave no sign of life for so long is taken for dead, and the force goes to zero. */
#define TOUCH_MAX_SILENCE_NS INT64_C(1000000000)
#define TOUCH_MAX_SILENT_STEP_NS INT64_C(100000000) /* more between two ticks was a pause of the servo's own */

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

#endif
