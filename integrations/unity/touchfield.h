/* touchfield.h: a receiver of .touch files (c/touch_play.h) behind an opaque handle, for languages that call C. All arguments
   are plain numbers; the library allocates what it needs, and copies the file.

       touchfield *player = touchfield_open(bytes, size);        // NULL: no memory; touchfield_error: why not
       touchfield_set(player, "force_max_n", 3.3);
       touchfield_start(player);
       touchfield_resume(player);
       // in a thread that decodes:    while (is_open) if (!touchfield_decode(player)) sleep a millisecond;
       // in the thread of the servo:  touchfield_tick(player, x, y, z, now_ns, force_n);
       // in one thread that orders:   touchfield_pause(player);  touchfield_seek(player, 1.5);  touchfield_stop(player);
       touchfield_close(player);                                 // after the other threads

   None of the three threads waits for another. */
#ifndef TOUCHFIELD_H
#define TOUCHFIELD_H

#include <stdint.h>

#if defined(_WIN32)
#define TOUCHFIELD_API __declspec(dllexport)
#else
#define TOUCHFIELD_API __attribute__((visibility("default")))
#endif

typedef struct touchfield touchfield;

/* Open the bytes of a file. */
TOUCHFIELD_API touchfield *touchfield_open(const void *bytes, uint64_t size);
/* Free everything. */
TOUCHFIELD_API void touchfield_close(touchfield *player);
/* Why it does not play, or no longer, or that the thread that decodes hangs; "" if all is well. */
TOUCHFIELD_API const char *touchfield_error(const touchfield *player);
/* Which way the axes of the medium point, such as "x right, y down, z forward". */
TOUCHFIELD_API const char *touchfield_axes(const touchfield *player);
/* Duration of the medium, seconds. */
TOUCHFIELD_API double touchfield_duration_s(const touchfield *player);
/* Greatest force that the medium allows, newtons. */
TOUCHFIELD_API double touchfield_force_max_n(const touchfield *player);

/* Set an option before touchfield_start; 0: there is no such option, or the value is not finite. Options of the device:
   force_max_n (0: that of the medium), force_continuous_n, delay_s, inertia_kg, resolution_m; of the renderer: rate_hz (1000),
   friction, damping_n_s_per_m, coupling_n_per_m (each below 0: as the medium states, or the stable value), wall_n_per_m,
   scale, force_scale, ramp_s, is_passive; of the player: is_loop, is_complete (no frame is left out, for a servo that waits
   with touchfield_is_ready), speed, start_s. touch_settings.h and touch_play.h describe them. */
TOUCHFIELD_API int touchfield_set(touchfield *player, const char *option, double value);
/* Lay out the receiver and decode the first frame, once; 0, or a code of touch.h. */
TOUCHFIELD_API int touchfield_start(touchfield *player);

/* Decode a frame ahead; 0: there is nothing to do now. If nobody calls it for a second, the force goes to zero. */
TOUCHFIELD_API int touchfield_decode(touchfield *player);

/* The force on a hand, newtons, at metres of the medium and nanoseconds of a clock that never goes back; 0: it is zero. */
TOUCHFIELD_API int touchfield_tick(touchfield *player, double x, double y, double z, int64_t now_ns, double force_n[3]);
/* Whether such a tick finds its frames: for a servo that may wait, as one of simulated time. */
TOUCHFIELD_API int touchfield_is_ready(const touchfield *player, int64_t now_ns);

TOUCHFIELD_API void touchfield_resume(touchfield *player);
/* The medium stands; its force stays. */
TOUCHFIELD_API void touchfield_pause(touchfield *player);
TOUCHFIELD_API void touchfield_seek(touchfield *player, double time_s);
/* Bring the force to zero for ever; touchfield_is_released says when it is there. */
TOUCHFIELD_API void touchfield_stop(touchfield *player);
TOUCHFIELD_API int touchfield_is_released(const touchfield *player);
/* Whether the medium has ended and the force is zero. */
TOUCHFIELD_API int touchfield_is_over(const touchfield *player);
/* Time of the medium at the latest tick, seconds. */
TOUCHFIELD_API double touchfield_media_s(const touchfield *player);

#endif
