/* touch_media_clock.h: which two frames a tick renders. A player, in another thread or process, publishes frames and gives
   orders (play, pause, seek, stop); the tick takes the latest order, advances the media clock, and finds the frames around it.

   An unrolled frame counts on in a loop. A generation rises with each seek; what was published for an earlier one is not used.

   The media clock stands at the beginning and after a seek until the first frames are there. Where a later one is late there
   is no force, but the clock goes on; only where nothing more will come does it stand. A paused medium keeps its force. */
#ifndef TOUCH_MEDIA_CLOCK_H
#define TOUCH_MEDIA_CLOCK_H

#include "touch_seam.h"
#include "touch_shared.h"

typedef struct { /* the frames of an instant, by their offsets from the first byte of the receiver */
    int64_t before_offset, after_offset; /* 0: there is none, hence no force */
    double blend;                        /* 0 to 1, from the one before to the one after */
    int64_t first_frame;                 /* the first one that may still be read */
} touch_frames;

/* The name of a frame: its generation above its unrolled number. */
static inline int64_t touch_tag(int64_t generation, int64_t unrolled_frame) {
    return (int64_t)((uint64_t)generation << TOUCH_FRAME_BITS) | unrolled_frame;
}

/* The entry of the directory in which a frame is published. */
static inline touch_directory_entry *touch_slot_of(touch_receiver *receiver, int64_t unrolled_frame) {
    touch_directory_entry *entries = (touch_directory_entry *)((char *)receiver + receiver->layout.directory_offset);
    return entries + (unrolled_frame & (receiver->layout.directory_slots - 1));
}

/* -- of the player: orders and frames --------------------------------------------------------------------------------- */

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

/* -- the media clock -------------------------------------------------------------------------------------------------- */

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

/* -- its frames ------------------------------------------------------------------------------------------------------- */

/* Where an unrolled frame lies; 0 if it is not there. */
static inline int64_t touch_frame_offset(touch_receiver *receiver, int64_t unrolled_frame) {
    const touch_directory_entry *entry = touch_slot_of(receiver, unrolled_frame);
    if (touch_shared(&entry->tag) != touch_tag(receiver->clock.generation, unrolled_frame)) return 0;
    TOUCH_FENCE();
    return touch_shared(&entry->frame_offset);
}

/* Whether no frame of this generation was used yet. */
static inline int touch_is_generation_new(const touch_clock *clock) {
    return clock->used >> TOUCH_FRAME_BITS != clock->generation;
}

/* The media clock runs again: these frames are there. Those that come after a seek, or late, begin with a seam. */
static inline void touch_use_frames(touch_receiver *receiver, double media_s, double clock_s, int64_t unrolled_frame) {
    touch_clock *clock = &receiver->clock;
    if (touch_is_generation_new(clock) || clock->feed == TOUCH_STALLED) receiver->state.seam.is_starting = 1;
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
    int is_due = touch_tag(receiver->clock.generation, found->first_frame) >= seam->frame;
    if (seam->is_cut && is_due) seam->is_cut = 0, seam->is_starting = 1; /* the frame after the jump is due: fade from here */
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

/* Whether frames of a seek, or late ones, are still to come. */
static inline int touch_are_frames_coming(const touch_receiver *receiver, int is_silent) {
    if (is_silent || touch_shared(&receiver->orders.has_feed_failed)) return 0;
    return touch_is_generation_new(&receiver->clock) || receiver->clock.feed == TOUCH_STALLED;
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
        receiver->state.seam.is_waiting = touch_are_frames_coming(receiver, is_silent);
        return none;
    }
    touch_use_frames(receiver, media_s, clock_s, found.first_frame);
    touch_find_seam(receiver, &found, following);
    return found;
}

#endif
