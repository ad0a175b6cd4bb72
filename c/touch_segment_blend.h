/* touch_segment_blend.h: from the last frame of a segment into the next segment: how long, and what bricks are on the way. Why
   is explained in src/touchfield/render/segment_blend.py. */
#ifndef TOUCH_SEGMENT_BLEND_H
#define TOUCH_SEGMENT_BLEND_H

#include "touch_cells.h"

/* A length of 0.1 s is three frames at 30 Hz, none of which makes more than half of the change; with 0.05 s the first frame
   would make three quarters. In fast media, the edge of a raised cosine of duration T has at most 1 / (4 f^2 T^2 - 1) of the
   amplitude that a step has at frequency f: 36 dB less at 40 Hz, where the band begins in which a hand feels vibration best.
   A longer blend gained nothing on a room at 30 Hz, and delays what moves by less than the mask. */
#define TOUCH_BLEND_S 0.1            /* of the medium */
#define TOUCH_MAX_UNBLENDED_HZ 20.0  /* up to this frame rate, the receiver interpolates for 50 ms or more anyway */

/* Frames from the start of a segment that are blended, a fraction too: at most half of a segment that another one follows. */
static inline double touch_blend_frames(double rate_hz, int64_t length, int is_last) {
    double frames = TOUCH_BLEND_S * rate_hz;
    return is_last ? frames : touch_fmin(frames, 0.5 * (double)length);
}

/* The weight of a frame of a segment against the last frame of the segment before: a raised cosine; 1: it is not blended. */
static inline double touch_blend_weight(double rate_hz, int64_t index, int64_t length, int is_last) {
    double frames = touch_blend_frames(rate_hz, length, is_last), passed = (double)index + 1.0;
    if (rate_hz <= TOUCH_MAX_UNBLENDED_HZ || passed >= frames) return 1.0;
    return 0.5 - 0.5 * cos(TOUCH_PI * passed / frames);
}

/* The weight of what was before a seam (touch_seam.h), where its fade has so long to go. */
static inline double touch_fade_weight(double left_s) { return 0.5 - 0.5 * cos(TOUCH_PI * left_s / TOUCH_BLEND_S); }

typedef struct {
    double weight; /* of the frame after */
    double k, f0_n; /* of the mask max(f0_n, k |F|) within which a decoded force is that of its source */
} touch_blend_rule;

/* Whether two forces, the differences of which are `d`, may be those of one source: both within their mask of it. */
TOUCH_INLINE int touch_is_one_source(const touch_blend_rule *rule, touch_vector before, touch_vector after, touch_vector d) {
    double square = touch_dot(d, d);
    if (!(square > 0.0)) return 0;
    if (!(square > 4.0 * rule->f0_n * rule->f0_n)) return 1; /* as near as this they may be, however small they are */
    double reach_n = touch_fmax(rule->f0_n, rule->k * sqrt(touch_dot(before, before))) +
                     touch_fmax(rule->f0_n, rule->k * sqrt(touch_dot(after, after)));
    return square <= reach_n * reach_n;
}

/* Blend bricks float [8][8][8][3] from `start` on, before `stop`. Brick n is before[slot[n]] and after[slot[bricks + n]],
   -1: zero. Where both forces may be of one source, out[n] is between them, elsewhere it is that after; has_force[n] is
   whether the brick has a force. */
static inline void touch_blend_bricks(const touch_blend_rule *rule, int64_t bricks, int64_t start, int64_t stop,
                                      const int64_t *slot, const float *before, const float *after, float *__restrict out,
                                      uint8_t *__restrict has_force) {
    static const float zero[3] = {0.0f, 0.0f, 0.0f};
    for (int64_t n = start; n < stop; n++) {
        const float *former = slot[n] < 0 ? NULL : before + TOUCH_BRICK_FLOATS * slot[n];
        const float *latest = slot[bricks + n] < 0 ? NULL : after + TOUCH_BRICK_FLOATS * slot[bricks + n];
        has_force[n] = 0;
        for (int s = 0; s < TOUCH_BRICK_FLOATS; s += 3) {
            const float *p = former ? former + s : zero, *q = latest ? latest + s : zero;
            float *to = out + TOUCH_BRICK_FLOATS * n + s;
            touch_vector a = touch_vector_of(p[0], p[1], p[2]), b = touch_vector_of(q[0], q[1], q[2]);
            touch_vector d = touch_subtract(b, a);
            to[0] = q[0];
            to[1] = q[1];
            to[2] = q[2];
            if (touch_is_one_source(rule, a, b, d)) {
                a = touch_add_scaled(a, rule->weight, d);
                to[0] = (float)a.x;
                to[1] = (float)a.y;
                to[2] = (float)a.z;
            }
            has_force[n] |= (uint8_t)touch_has_force(to);
        }
    }
}

#endif
