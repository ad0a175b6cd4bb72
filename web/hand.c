/* The hand: the receiver of c/touch_play.h on the open file, ticking a thousand times a second. It runs in an instance of the
   module, and a thread, of its own, so that no frame that is drawn delays it.

   The probe of the page is the device. It jumps from one event of a pointer to the next, some centimetres in 16 ms; the
   device follows it smoothly, as a handle would, and is lifted and put down elsewhere where the page says so. */
#define TOUCH_HAS_EXTRAS 0
#define TOUCH_INLINE static inline /* small rather than fast: a tick takes microseconds */
#pragma clang attribute push(__attribute__((minsize)), apply_to = function)
#include "../c/touch_play.h"
#include "page.h"

enum {
    HAND_TICK_NS = 1000000,
    HAND_MAX_TICKS = 20,     /* that are caught up at once */
    HAND_PAUSE_TICKS = 1000, /* more that are due are those of a page that was hidden: none is missed */
    HAND_AHEAD = 16,
    HAND_FRAMES_BYTES = 1 << 26
};
#define HAND_FOLLOW_S 0.008       /* time constant of the device behind the probe */
#define HAND_MAX_LAG_S 0.3        /* of the media time behind the page's: more is a seek */
#define HAND_MAX_LAG_FRAMES 0.25  /* the same where the medium stands */
#define HAND_CATCH_UP_PER_S 2.0   /* part of a lag that is made up in a second */
#define HAND_MAX_SPEED 4.0        /* at more the medium passes too fast to be felt, and there is no force */

typedef struct { /* where the page has the probe */
    touch_vector target_m, device_m, lifted_to_m;
    int has_device, is_lifted;
} hand_probe;

typedef struct { /* what the page reads: the means of the ticks since it read before */
    double force_n[3], proxy_m[3], device_m[3];
    double is_in_contact, ticks, media_s, code, missed;
} hand_report;

static touch_play hand_play;
static hand_probe hand_at;
static hand_report hand_sums;
static touch_limited hand_before; /* the force on the file before */
static int64_t hand_next_ns, hand_missed;
static int hand_is_open, hand_is_seeking;

static int hand_fail(int code, const char *why) {
    page_message = why;
    return code;
}

/* Before the bytes of another file come. */
EXPORT(hand_close) void hand_close(void) {
    if (hand_is_open) hand_before = hand_play.receiver->state.force;
    hand_is_open = 0;
}

/* Open the file of `room` for the hand. A force on the file before goes to zero as at a seek. */
EXPORT(hand_open) int hand_open(void) {
    touch_device device;
    memset(&device, 0, sizeof device);
    int code = touch_play_open(&hand_play, (const void *)(uintptr_t)page_file_at, page_file_size, &device);
    if (code) return hand_fail(code, hand_play.error);
    touch_play_options *options = &hand_play.options;
    options->is_loop = 1, options->max_ahead = HAND_AHEAD, options->frames_bytes = HAND_FRAMES_BYTES;
    uint64_t start = (page_file_at + page_file_size + 63) & ~(uint64_t)63, size = touch_play_room(&hand_play);
    if (size > UINT32_MAX || !page_reach(start + size)) return hand_fail(TOUCH_MEMORY, "the field is too large");
    code = touch_play_start(&hand_play, (void *)(uintptr_t)start);
    if (code) return hand_fail(code, hand_play.error);
    touch_tick_state *state = &hand_play.receiver->state;
    state->force.output = state->force.desired = hand_before.output, state->force.heat = hand_before.heat;
    state->gain = touch_is_zero(hand_before.output) ? 0.0 : 1.0;
    touch_play_pause(&hand_play);
    hand_is_open = 1, hand_is_seeking = 0;
    return TOUCH_OK;
}

/* -- orders of the page -------------------------------------------------------------------------------------------- */

/* Lift the device, to put it down at a point, or where the proxy is now: it never comes down behind a wall. */
static void hand_lift(touch_vector to_m, int has_point) {
    const touch_proxy *proxy = &hand_play.receiver->state.proxy;
    if (!has_point) {
        if (hand_at.is_lifted || !hand_at.has_device) return;
        to_m = proxy->is_active ? proxy->position_m : hand_at.device_m;
    }
    hand_at.is_lifted = 1, hand_at.lifted_to_m = to_m;
}

/* Move the probe to a point; the device follows, or is lifted and put down at another point first. */
EXPORT(hand_move) void hand_move(double x, double y, double z, int is_lifted, double from_x, double from_y, double from_z) {
    hand_at.target_m = touch_vector_of(x, y, z);
    if (!is_lifted && (hand_at.has_device || hand_at.is_lifted)) return;
    hand_lift(is_lifted ? touch_vector_of(from_x, from_y, from_z) : hand_at.target_m, 1);
}

static double hand_media_s(void) {
    double seconds = hand_play.file.frame_count / hand_play.file.rate_hz, media_s = hand_play.receiver->clock.media_s;
    return hand_play.file.frame_count > 1 ? fmod(media_s, seconds) : 0.0;
}

/* How far the media time is behind the page's, seconds, the shorter way round a loop. */
static double hand_lag_s(double time_s) {
    double seconds = hand_play.file.frame_count / hand_play.file.rate_hz, lag = time_s - hand_media_s();
    if (lag > 0.5 * seconds) lag -= seconds;
    if (lag < -0.5 * seconds) lag += seconds;
    return lag;
}

/* The page is at a media time, and plays with a speed (0: it stands). A small lag is made up by the speed, so that the
   force knows nothing of it; a larger one is a seek, over which the force goes to zero and comes back. */
EXPORT(hand_follow) void hand_follow(double time_s, double speed) {
    if (!hand_is_open || hand_play.file.frame_count < 2) return;
    const touch_orders *orders = &hand_play.receiver->orders;
    int64_t mode = speed > HAND_MAX_SPEED ? TOUCH_IDLE : speed > 0.0 ? TOUCH_PLAYING : TOUCH_PAUSED;
    int is_fresh = hand_play.receiver->clock.generation != orders->generation; /* the order before is not taken yet */
    double lag_s = is_fresh ? time_s - orders->start_s : hand_lag_s(time_s);
    double max_s = speed > 0.0 ? HAND_MAX_LAG_S * speed : HAND_MAX_LAG_FRAMES / hand_play.file.rate_hz;
    if (mode != TOUCH_IDLE && fabs(lag_s) > max_s) {
        hand_is_seeking = 1;
        hand_lift(touch_zero(), 0);
        touch_give_order(hand_play.receiver, orders->generation + 1, touch_play_media_time(&hand_play, time_s),
                         speed > 0.0 ? speed : orders->speed, mode, 0);
        return;
    }
    double ratio = 1.0 + touch_clamp(HAND_CATCH_UP_PER_S * lag_s / touch_fmax(speed, 1e-9), -0.5, 0.5);
    double wanted = mode == TOUCH_PLAYING ? speed * ratio : orders->speed;
    if (mode == orders->mode && fabs(wanted - orders->speed) <= 0.01 * orders->speed) return;
    touch_give_order(hand_play.receiver, orders->generation, orders->start_s, wanted, mode, 0);
}

/* -- ticks --------------------------------------------------------------------------------------------------------- */

/* Whether there is a frame of the latest order. */
static int hand_has_frames(void) {
    const touch_clock *clock = &hand_play.receiver->clock;
    return clock->generation == hand_play.receiver->orders.generation && clock->used >> TOUCH_FRAME_BITS == clock->generation;
}

/* The device at the next tick. While it is lifted its position is not known, and the force goes to zero; it is put down
   where there is a field, from which a proxy can start. */
static touch_vector hand_step(void) {
    const double none = __builtin_nan("");
    touch_tick_state *state = &hand_play.receiver->state;
    if (hand_at.is_lifted) {
        if (state->gain > 0.0 || !hand_has_frames()) return touch_vector_of(none, none, none);
        hand_at.device_m = hand_at.lifted_to_m, hand_at.has_device = 1, hand_at.is_lifted = 0;
        state->is_started = 0; /* the way there was none of the hand: no velocity, no work */
    }
    double fraction = -expm1(-1e-9 * HAND_TICK_NS / HAND_FOLLOW_S);
    touch_vector way = touch_subtract(hand_at.target_m, hand_at.device_m);
    hand_at.device_m = touch_add_scaled(hand_at.device_m, fraction, way);
    return hand_at.device_m;
}

/* Compute the ticks that are due at a time of the clock, milliseconds; at most some, the others are counted as missed. */
EXPORT(hand_run) void hand_run(double now_ms) {
    int64_t now_ns = (int64_t)(1e6 * now_ms), due = (now_ns - hand_next_ns) / HAND_TICK_NS + 1;
    if (!hand_is_open || now_ns < hand_next_ns) return;
    int64_t missed = due - (due < HAND_PAUSE_TICKS ? HAND_MAX_TICKS : 1);
    if (missed > 0) {
        if (due < HAND_PAUSE_TICKS) hand_missed += missed;
        hand_next_ns += missed * HAND_TICK_NS;
    }
    for (; hand_next_ns <= now_ns; hand_next_ns += HAND_TICK_NS) {
        touch_vector force = touch_receiver_tick(hand_play.receiver, hand_step(), hand_next_ns);
        hand_sums.force_n[0] += force.x, hand_sums.force_n[1] += force.y, hand_sums.force_n[2] += force.z;
        hand_sums.ticks += 1.0;
    }
}

/* Decode a frame; 0: there is nothing to be done now. After a seek the force goes to zero first. */
EXPORT(hand_decode) int hand_decode(void) {
    if (!hand_is_open) return 0;
    const touch_receiver *receiver = hand_play.receiver;
    if (hand_is_seeking && (receiver->clock.generation != receiver->orders.generation || receiver->state.gain > 0.0)) return 0;
    hand_is_seeking = 0;
    return touch_play_decode(&hand_play);
}

static void hand_put(double to[3], touch_vector v) { to[0] = v.x, to[1] = v.y, to[2] = v.z; }

/* What has been rendered since the last report. */
EXPORT(hand_report) const double *hand_report_of(void) {
    static hand_report report;
    const touch_tick_state *state = &hand_play.receiver->state;
    report = hand_sums;
    for (int n = 0; n < 3 && report.ticks > 0; n++) report.force_n[n] /= report.ticks;
    hand_put(report.proxy_m, state->proxy.is_active ? state->proxy.position_m : hand_at.device_m);
    hand_put(report.device_m, hand_at.device_m);
    report.is_in_contact = (double)(state->proxy.is_active && state->proxy.is_in_contact);
    if (hand_play.code) page_message = hand_play.error;
    report.media_s = hand_media_s(), report.code = hand_play.code, report.missed = (double)hand_missed;
    memset(&hand_sums, 0, sizeof hand_sums);
    return (const double *)&report;
}

#pragma clang attribute pop
