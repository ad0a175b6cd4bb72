/* bench_stability.py: one touch of a wall by a hand on a device, in closed loop with the servo's tick. */
#include "../c/touch_render.h"

#include <stdlib.h>

#define TICK_S 0.001
#define START_M 0.010
#define SETTLED_N 0.005
enum { APPROACH_TICKS = 300, SECOND_TICKS = 1000, MAX_PRESS_TICKS = 60000, RETREAT_TICKS = 400, MAX_DELAY_TICKS = 8 };

typedef struct {
    double step[2][3]; /* position and velocity after a tick, from position, velocity and push */
    double k, b;       /* spring of the hand, damping of the device */
    double depth_m;    /* of the hand's target behind the wall */
    double resolution_m;
    int64_t delay_ticks;
} touch_case;

typedef struct { /* of the last second of pressing; net energy of all; and how long it pressed */
    double rms_n, mean_n, energy_j, work_j, depth_m, press_s;
} touch_result;

/* Where the hand wants to be: it approaches, presses, and retreats `left` ticks before the end. */
static double target_of(const touch_case *c, int64_t tick, int64_t left) {
    double way = START_M + c->depth_m;
    if (tick < APPROACH_TICKS) return START_M - way * (double)tick / APPROACH_TICKS;
    return left >= 0 ? -c->depth_m + way * (1.0 - (double)left / RETREAT_TICKS) : -c->depth_m;
}

static double force_at_position(touch_receiver *receiver, int64_t frame, const touch_case *c, double x) {
    if (c->resolution_m > 0.0) x = rint(x / c->resolution_m) * c->resolution_m;
    return touch_tick(receiver, frame, frame, 0.0, touch_vector_of(0.0, 0.0, x), TICK_S).z;
}

/* Simulates a touch: until the force is steady, or its oscillation decays no further, and the retreat. */
void simulate_touch(touch_receiver *receiver, int64_t frame, const touch_case *c, touch_result *result) {
    double x = START_M, v = 0.0, held_j = 0.0, sum = 0.0, squares = 0.0, depth = 0.0, start_x = x, late[MAX_DELAY_TICKS] = {0};
    int64_t stop = INT64_MAX, delay = c->delay_ticks < MAX_DELAY_TICKS ? c->delay_ticks : MAX_DELAY_TICKS - 1;
    result->rms_n = 1e9, result->work_j = 0.0;
    for (int64_t n = 0; n < stop;) {
        double target = target_of(c, n, stop < INT64_MAX ? stop - n : -1);
        double force = force_at_position(receiver, frame, c, x);
        late[n % (delay + 1)] = force;
        double acting = late[(n + 1) % (delay + 1)], push = acting + c->k * target;
        double next_x = c->step[0][0] * x + c->step[0][1] * v + c->step[0][2] * push;
        double next_v = c->step[1][0] * x + c->step[1][1] * v + c->step[1][2] * push;
        result->work_j += acting * (next_x - x) - c->b * (next_x - x) * (next_x - x) / TICK_S;
        if (stop == INT64_MAX) {
            held_j += acting * (next_x - x);
            sum += force, squares += force * force, depth -= x;
        }
        x = next_x, v = next_v, n++;
        if (stop < INT64_MAX || (n - APPROACH_TICKS) % SECOND_TICKS) continue;
        double before = result->rms_n, mean = sum / SECOND_TICKS, variance = squares / SECOND_TICKS - mean * mean;
        result->mean_n = mean, result->rms_n = sqrt(variance > 0.0 ? variance : 0.0);
        int is_steady = result->rms_n < SETTLED_N || result->rms_n > 0.995 * before;
        if (n >= APPROACH_TICKS + MAX_PRESS_TICKS || (n >= APPROACH_TICKS + 2 * SECOND_TICKS && is_steady)) {
            stop = n + RETREAT_TICKS;
            result->energy_j = held_j - mean * (x - start_x), result->depth_m = depth / SECOND_TICKS;
        }
        sum = squares = depth = held_j = 0.0, start_x = x;
    }
    result->press_s = (double)(stop - RETREAT_TICKS - APPROACH_TICKS) / SECOND_TICKS;
}
