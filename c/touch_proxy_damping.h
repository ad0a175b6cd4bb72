/* touch_proxy_damping.h: a damper where the force that the proxy of touch_proxy.h adds has given out more work than it got.

   A proxy adds a = F - F_stored to the stored force. The sum is no gradient: a hand that goes round beside an edge gets a little
   more work out of a than it puts in, and would swing for ever. So the work is accounted for. What the hand
   does against a is credited, up to what a spring K holds at that force, |a|^2 / 2 K, and what a does on the hand is
   subtracted. A thin wall that is pressed and let go gives back what it took, and the balance does not become negative.
   Where it does, hands are damped, slow ones in full and fast ones hardly, as these leave. A negative balance fades. Friction
   acts along the surface only, and takes no work that a does across it. */
#ifndef TOUCH_PROXY_DAMPING_H
#define TOUCH_PROXY_DAMPING_H

#include "touch_proxy_search.h"

#define TOUCH_PROXY_DAMPING_N_S_PER_M 8.0     /* at most, on the device */
#define TOUCH_PROXY_DAMPING_M_S 0.02          /* speed of the device at which it is half as large */
#define TOUCH_PROXY_DAMPING_N 0.05            /* force on the device that the proxy adds: a smaller one is damped less */
#define TOUCH_PROXY_DAMPING_DEBT 0.1          /* of |a|^2 / 2 K: a balance that is so far below zero is damped in full */
#define TOUCH_PROXY_DAMPING_FADE_S 1.0        /* time constant in which a negative balance fades, */
#define TOUCH_PROXY_DAMPING_TURN_S 0.02       /* and in which the damper comes and goes */
#define TOUCH_PROXY_DAMPING_LEAST 1e-3        /* of the damper: less, where nothing is added, is none */

/* What the proxy added to the stored force in the latest tick, N, less what it owes. */
static inline touch_vector touch_added_by_proxy(const touch_proxy *proxy) {
    return touch_subtract(touch_subtract(proxy->force_n, proxy->eased_n), proxy->stored_n);
}

/* How much of the damper an added force allows, 0 to 1. */
static inline double touch_damping_share(const touch_settings *settings, touch_vector added_n) {
    return touch_fmin(1.0, settings->force_scale * touch_magnitude(added_n) / TOUCH_PROXY_DAMPING_N);
}

/* Account for the work of what the proxy adds, where it added `before_n` in the tick before and the hand has moved. The
   balance is at least that of a large force of the field, so that a leap of the hand leaves no debt for long. */
static inline void touch_account_work(const touch_isosurface *s, double softness, touch_vector motion_m, touch_vector before_n,
                                      double dt_s) {
    touch_proxy *proxy = &s->receiver->state.proxy;
    touch_vector now_n = touch_added_by_proxy(proxy);
    double k = softness * s->stiffness_n_per_m, spring_j = touch_dot(now_n, now_n) / (2.0 * k);
    double balance_j = proxy->work_j - 0.5 * touch_dot(touch_add(before_n, now_n), motion_m);
    if (balance_j < 0.0) balance_j *= exp(-dt_s / TOUCH_PROXY_DAMPING_FADE_S);
    if (!touch_is_finite(now_n)) balance_j = spring_j = 0.0;
    proxy->work_j = touch_clamp(balance_j, -s->large_n * s->large_n / (2.0 * k), spring_j);
    double goal = 0.0;
    if (proxy->work_j < 0.0 && spring_j > 0.0) goal = touch_fmin(1.0, -proxy->work_j / (TOUCH_PROXY_DAMPING_DEBT * spring_j));
    goal *= touch_damping_share(&s->receiver->settings, now_n);
    proxy->damping += (goal - proxy->damping) * -expm1(-dt_s / TOUCH_PROXY_DAMPING_TURN_S);
    if (!(goal > 0.0) && proxy->damping < TOUCH_PROXY_DAMPING_LEAST) proxy->damping = 0.0;
}

/* The force of the damper on the hand, N, in the axes and for a velocity of the device. */
static inline touch_vector touch_proxy_damping_force(const touch_receiver *receiver, touch_vector device_velocity_m_s) {
    const touch_settings *settings = &receiver->settings;
    const touch_proxy *proxy = &receiver->state.proxy;
    if (!(settings->wall_n_per_m > 0.0 && proxy->is_active)) return touch_zero();
    double speed = touch_magnitude(device_velocity_m_s) / TOUCH_PROXY_DAMPING_M_S;
    double damper_n_s_per_m = proxy->damping * TOUCH_PROXY_DAMPING_N_S_PER_M / (1.0 + speed * speed);
    return touch_scale(-damper_n_s_per_m, device_velocity_m_s);
}

#endif
