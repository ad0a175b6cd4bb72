/* touch_proxy_damping.h: a damper where the force on a hand at the proxy of touch_proxy.h has given out more work than it got.

   Neither a coded field nor what a proxy adds to it is the gradient of a potential. A hand that goes round beside an edge gets
   a little more work out of the force than it puts in, and would swing for ever. So the work of the whole force is accounted
   for: of the field, the proxy, friction and dampers. A hand that slides, or is pressed, does work all the time; only swings
   count. A swing is what is left of force and motion, low-passed, without their means over some tenths of a second,

       d = F - mean of F,    v' = v - mean of v

   What the hand does against d is credited, up to what a spring K holds at that force, |d|^2 / 2 K, and what d does on the hand
   is subtracted. The motion is that in space or beside the surface, whichever gives less, so that neither a surface that comes
   nor one that goes looks as if it gave out work. A negative balance fades. As far as it is below zero, beside the mean of
   |d|^2 / 2 K, the damper acts against v', slow swings in full and fast ones hardly. It is at most a small share of the force
   of the contact, so that it ends as softly as the contact does. It waits for some turns of the swing, which a hand that lands
   or slides does not make, and lets hum pass, which it would make louder. */
#ifndef TOUCH_PROXY_DAMPING_H
#define TOUCH_PROXY_DAMPING_H

#include "touch_proxy_jump.h"
#include "touch_proxy_search.h"

#define TOUCH_PROXY_DAMPING_N_S_PER_M 8.0     /* at most, on the device */
#define TOUCH_PROXY_DAMPING_M_S 0.05          /* speed of a swing on the device at which it is half as large */
#define TOUCH_PROXY_DAMPING_SHARE 0.1         /* of the force of the contact: the damper's is at most so much */
#define TOUCH_PROXY_DAMPING_N 0.005           /* swing of the force on the device: a smaller one is damped less */
#define TOUCH_PROXY_DAMPING_TURNS 3.0         /* of a swing: with fewer it does not last; with twice as many the damper acts; */
#define TOUCH_PROXY_DAMPING_HUM 25.0          /* with more it is hum, as of an encoder; with twice as many none acts */
#define TOUCH_PROXY_DAMPING_LOW_S 0.008       /* time constant of the low-pass of force and motion, */
#define TOUCH_PROXY_DAMPING_MEAN_S 0.2        /* of the means, */
#define TOUCH_PROXY_DAMPING_FADE_S 1.0        /* in which a negative balance fades, */
#define TOUCH_PROXY_DAMPING_TURNS_S 1.0       /* in which turns are forgotten, */
#define TOUCH_PROXY_DAMPING_COME_S 0.5        /* and in which the damper comes */
#define TOUCH_PROXY_DAMPING_GO_S 0.05         /* and goes */

/* A proxy that is new has neither swung nor done work. */
static inline void touch_start_swing(touch_swing *swing) { memset(swing, 0, sizeof *swing); }

/* Move a low-passed vector towards its input, in a tick that has `weight` of it. */
static inline void touch_low_pass(touch_vector *smooth, double weight, touch_vector input) {
    *smooth = touch_add_scaled(*smooth, weight, touch_subtract(input, *smooth));
}

/* Count the turns of a swing, which are forgotten with time. */
static inline void touch_count_turns(touch_swing *swing, touch_vector off_n, double dt_s) {
    double along = touch_dot(off_n, swing->turn_n);
    if (along < 0.0) swing->turns += 1.0;
    if (along < 0.0 || touch_dot(off_n, off_n) > touch_dot(swing->turn_n, swing->turn_n)) swing->turn_n = off_n;
    swing->turns *= exp(-dt_s / TOUCH_PROXY_DAMPING_TURNS_S);
}

/* How much of the damper is to act, 0 to 1. */
static inline double touch_damping_goal(const touch_isosurface *s) {
    const touch_swing *swing = &s->receiver->state.proxy.swing;
    if (!(swing->work_j < 0.0 && swing->spring_j > 0.0)) return 0.0;
    double lasts = touch_clamp(swing->turns / TOUCH_PROXY_DAMPING_TURNS - 1.0, 0.0, 1.0);
    double hums = touch_clamp(swing->turns / TOUCH_PROXY_DAMPING_HUM - 1.0, 0.0, 1.0);
    double device_n = s->receiver->settings.force_scale * sqrt(2.0 * s->stiffness_n_per_m * swing->spring_j);
    double felt = touch_fmin(1.0, device_n / TOUCH_PROXY_DAMPING_N);
    return lasts * (1.0 - hums) * felt * touch_fmin(1.0, -swing->work_j / swing->spring_j);
}

/* Account for the work of a tick, in which the hand moved while it was pushed by pushed_n. The balance is at least that of a
   large force of the field, so that a leap of the hand leaves no debt for long. */
static inline void touch_account_work(const touch_isosurface *s, const touch_contact_motion *motion, double dt_s) {
    touch_swing *swing = &s->receiver->state.proxy.swing;
    if (!(dt_s > 0.0)) return;
    double k = s->stiffness_n_per_m, weight = -expm1(-dt_s / TOUCH_PROXY_DAMPING_LOW_S);
    touch_low_pass(&swing->force_n, weight, swing->pushed_n);
    touch_low_pass(&swing->space_m_s, weight, touch_divided(motion->space_m, dt_s));
    touch_low_pass(&swing->beside_m_s, weight, touch_divided(motion->beside_m, dt_s));

    touch_vector off_n = touch_subtract(swing->force_n, swing->mean_n);
    double in_space_w = touch_dot(off_n, touch_subtract(swing->space_m_s, swing->mean_m_s));
    double beside_w = touch_dot(off_n, touch_subtract(swing->beside_m_s, swing->mean_m_s));
    double spring_j = touch_dot(off_n, off_n) / (2.0 * k);
    double balance_j = swing->work_j - dt_s * touch_fmin(in_space_w, beside_w);
    if (balance_j < 0.0) balance_j *= exp(-dt_s / TOUCH_PROXY_DAMPING_FADE_S);
    if (!(fabs(balance_j) < HUGE_VAL)) balance_j = spring_j = 0.0;
    swing->work_j = touch_clamp(balance_j, -s->large_n * s->large_n / (2.0 * k), spring_j);

    weight = -expm1(-dt_s / TOUCH_PROXY_DAMPING_MEAN_S);
    touch_low_pass(&swing->mean_n, weight, swing->force_n);
    touch_low_pass(&swing->mean_m_s, weight, swing->space_m_s);
    swing->spring_j += weight * (spring_j - swing->spring_j);
    touch_count_turns(swing, off_n, dt_s);
    double goal = touch_damping_goal(s);
    double time_s = goal > swing->damping ? TOUCH_PROXY_DAMPING_COME_S : TOUCH_PROXY_DAMPING_GO_S;
    swing->damping += (goal - swing->damping) * -expm1(-dt_s / time_s);
}

/* The force of the damper on the hand, N, in the field's axes. */
static inline touch_vector touch_proxy_damping_force(const touch_receiver *receiver) {
    const touch_settings *settings = &receiver->settings;
    const touch_proxy *proxy = &receiver->state.proxy;
    if (!(settings->wall_n_per_m > 0.0 && proxy->is_active)) return touch_zero();
    touch_vector swing_m_s = touch_subtract(receiver->state.velocity_m_s, proxy->swing.mean_m_s);
    double speed_m_s = touch_magnitude(swing_m_s);
    if (!(speed_m_s > 0.0)) return touch_zero();
    double device_m_s = speed_m_s / settings->scale, halves = device_m_s / TOUCH_PROXY_DAMPING_M_S;
    double device_n = proxy->swing.damping * TOUCH_PROXY_DAMPING_N_S_PER_M * device_m_s / (1.0 + halves * halves);
    double contact_n = touch_magnitude(touch_subtract(proxy->force_n, proxy->eased_n));
    double damper_n = touch_fmin(device_n / settings->force_scale, TOUCH_PROXY_DAMPING_SHARE * contact_n);
    return touch_scale(-damper_n / speed_m_s, swing_m_s);
}

#endif
