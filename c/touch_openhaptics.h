/* touch_openhaptics.h: the callback that the vendor's driver OpenHaptics calls at each tick, in a thread of its own: begin a
   frame, read position and buttons, one tick of the renderer, set the force, end the frame. The library is not needed to
   compile this: the program that loads it gives the addresses of its functions. */
#ifndef TOUCH_OPENHAPTICS_H
#define TOUCH_OPENHAPTICS_H

#include "touch_render.h"

#ifdef _WIN32
__declspec(dllimport) int __stdcall QueryPerformanceCounter(int64_t *ticks);
__declspec(dllimport) int __stdcall QueryPerformanceFrequency(int64_t *ticks_per_s);
#else
#include <time.h>
#endif

/* -- declarations of the vendor's library ----------------------------------------------------------------------------- */

enum { TOUCH_HD_CALL_NO_MORE = 0, TOUCH_HD_CALL_AGAIN = 1 };
/* HD_CURRENT_BUTTONS, HD_CURRENT_POSITION, HD_CURRENT_FORCE */
enum { TOUCH_HD_BUTTONS = 0x2000, TOUCH_HD_POSITION_MM = 0x2050, TOUCH_HD_FORCE_N = 0x2700 };
enum { TOUCH_HD_CALIBRATION_OK = 0x5000, TOUCH_HD_CALIBRATION_NEEDS_UPDATE = 0x5001 };
enum { TOUCH_HD_FORCE_ERRORS = 2 }; /* 0x02xx: the driver itself limits the force for a while (warm motors, or a fast hand) */

typedef struct { /* HDErrorInfo */
    unsigned code;
    int internal_code;
    unsigned device;
} touch_hd_error;

/* -- the callback ----------------------------------------------------------------------------------------------------- */

enum { TOUCH_DRIVER_STOPPED = 1, TOUCH_DRIVER_FAILED = 2 }; /* reasons why it is not called again */
enum { TOUCH_CALIBRATION_FRAMES = 64 };                     /* the calibration is checked once in so many */

typedef struct { /* of the callback and the program; every number has eight bytes */
    touch_receiver *receiver;
    touch_vector (*tick)(touch_receiver *receiver, touch_vector device_m, int64_t now_ns); /* touch_receiver_tick */
    void (*begin_frame)(unsigned device); /* hdBeginFrame and so on */
    void (*end_frame)(unsigned device);
    void (*get_doubles)(unsigned what, double *values);
    void (*set_doubles)(unsigned what, const double *values);
    touch_hd_error (*get_error)(void);
    void (*get_integers)(unsigned what, int *values); /* this and the next two: 0 where the library has none */
    unsigned (*check_calibration)(void);
    void (*update_calibration)(unsigned style);
    int64_t device;      /* the driver's handle */
    int64_t must_stop;   /* set by the program: one more frame, of zero force */
    int64_t end;         /* TOUCH_DRIVER_...; 0 while it is called */
    int64_t calls;
    int64_t error;       /* the first fault that the driver reported; 0: none */
    int64_t style;       /* of the calibration that the device can do without help; 0: none */
    int64_t calibration; /* HD_CALIBRATION_...; 0 before it is known */
    int64_t frame_ns;    /* from the start of the latest frame to its end */
    int64_t *buttons;    /* where those of the latest frame are written; 0: nowhere */
    touch_vector position_mm, force_n;
} touch_driver;

/* A clock that never goes back: that of Python's time.perf_counter_ns. */
static inline int64_t touch_now_ns(void) {
#ifdef _WIN32
    int64_t ticks = 0, ticks_per_s = 1;
    (void)QueryPerformanceCounter(&ticks), (void)QueryPerformanceFrequency(&ticks_per_s);
    return ticks / ticks_per_s * 1000000000 + ticks % ticks_per_s * 1000000000 / ticks_per_s;
#else
    struct timespec now;
#ifdef __APPLE__
    (void)clock_gettime(CLOCK_UPTIME_RAW, &now);
#else
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
#endif
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
#endif
}

/* Read the buttons, and at some frames the calibration. */
static inline void touch_driver_read_state(touch_driver *driver) {
    int buttons = 0;
    if (driver->get_integers && driver->buttons) {
        driver->get_integers(TOUCH_HD_BUTTONS, &buttons);
        touch_share(driver->buttons, buttons);
    }
    if (driver->check_calibration && driver->calls % TOUCH_CALIBRATION_FRAMES == 0)
        touch_share(&driver->calibration, driver->check_calibration());
}

/* A device that lost its calibration has no valid position, and hence no force. */
static inline int touch_driver_is_calibrated(const touch_driver *driver) {
    return !driver->calibration || driver->calibration == TOUCH_HD_CALIBRATION_OK;
}

/* The next force, N; zero where the callback ends. A force that is not finite would stay on the device: it ends, too. */
static inline touch_vector touch_driver_force(touch_driver *driver, int64_t *end) {
    touch_vector position = touch_zero();
    *end = touch_shared(&driver->must_stop) ? TOUCH_DRIVER_STOPPED : 0;
    if (*end) return touch_zero();
    driver->get_doubles(TOUCH_HD_POSITION_MM, &position.x);
    driver->position_mm = position;
    position = touch_vector_of(position.x / 1000.0, position.y / 1000.0, position.z / 1000.0);
    if (!touch_driver_is_calibrated(driver)) position = touch_vector_of(NAN, NAN, NAN);
    touch_vector force = driver->tick(driver->receiver, position, touch_now_ns());
    if (touch_is_finite(force)) return force;
    *end = TOUCH_DRIVER_FAILED;
    return touch_zero();
}

/* HDCallbackCode of a call; `user` is a touch_driver. */
static inline unsigned touch_openhaptics_callback(void *user) {
    touch_driver *driver = (touch_driver *)user;
    unsigned device = (unsigned)driver->device;
    int64_t end, start_ns = touch_now_ns();
    touch_share(&driver->calls, driver->calls + 1);
    driver->begin_frame(device);
    touch_driver_read_state(driver);
    driver->force_n = touch_driver_force(driver, &end);
    driver->set_doubles(TOUCH_HD_FORCE_N, &driver->force_n.x);
    driver->end_frame(device);
    touch_share(&driver->frame_ns, touch_now_ns() - start_ns);
    if (driver->calibration == TOUCH_HD_CALIBRATION_NEEDS_UPDATE && driver->update_calibration && driver->style &&
        driver->calls % TOUCH_CALIBRATION_FRAMES == 0)
        driver->update_calibration((unsigned)driver->style);
    int64_t code = driver->get_error().code;
    if (code && code >> 8 != TOUCH_HD_FORCE_ERRORS && !driver->error) touch_share(&driver->error, code);
    if (!end) return TOUCH_HD_CALL_AGAIN;
    touch_share(&driver->end, end);
    return TOUCH_HD_CALL_NO_MORE;
}

#endif
