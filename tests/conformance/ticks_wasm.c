/* The tick of c/touch_render.h for WebAssembly, for tests: ticks.mjs calls it from node. */
#include "touch_render.h"

#define EXPORT(name) __attribute__((export_name(#name)))
extern unsigned char __heap_base;

static touch_receiver *receiver;
static double forces[6]; /* N, and N m */

/* Bytes of a receiver, without what lies behind it. */
EXPORT(receiver_bytes) double receiver_bytes(void) { return (double)sizeof(touch_receiver); }

/* Zeros for a receiver; its address. */
EXPORT(room) char *room(double bytes) {
    size_t start = ((size_t)&__heap_base + 63) & ~(size_t)63, pages = ((size_t)bytes + start) / 65536 + 1;
    size_t own = __builtin_wasm_memory_size(0);
    if (pages > own && __builtin_wasm_memory_grow(0, pages - own) == (size_t)-1) return NULL;
    receiver = (touch_receiver *)start;
    memset(receiver, 0, (size_t)bytes);
    return (char *)receiver;
}

EXPORT(orient) void orient(double w, double x, double y, double z) {
    double *q = receiver->grip.orientation;
    q[0] = w, q[1] = x, q[2] = y, q[3] = z;
}

/* Force and torque of a tick, six numbers. */
EXPORT(tick) const double *tick(double before, double after, double blend, double x, double y, double z, double dt_s,
                                double is_release) {
    touch_vector torque, f = is_release != 0.0
                                 ? touch_release(receiver, dt_s)
                                 : touch_tick(receiver, (int64_t)before, (int64_t)after, blend, touch_vector_of(x, y, z), dt_s);
    torque = receiver->state.torque.output;
    forces[0] = f.x, forces[1] = f.y, forces[2] = f.z;
    forces[3] = torque.x, forces[4] = torque.y, forces[5] = torque.z;
    return forces;
}
