/* A stand-in for OpenHaptics: calls back from a thread of its own, records every force, checks the order of calls. */
#include <pthread.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

typedef struct { unsigned code; int internal_code; unsigned device; } Error;
typedef unsigned (*Callback)(void *);

enum { DEVICE = 7, OPERATION = 42, MOST = 200000 };

static double forces[MOST][3], current[3];
static unsigned long count, calls;
static unsigned errors[16];
static int error_count, with_device, enabled, in_frame, got, set_force, started, scheduled, running;
static char faults[400], failing[40], configuration[100], log_[64];
static unsigned failing_code;
static Callback callback;
static void *user;
static pthread_t thread;

/* calibration: its code, the call from which on the device accepts an update, and that until which the position is frozen */
enum { CALIBRATED = 0x5000, INKWELL = 4 };
static unsigned calibration;
static unsigned long update_from, frozen_until;
static int buttons;
static char serial[20];

static void fault(const char *words) { if (!faults[0]) snprintf(faults, sizeof faults, "%s", words); }
static void need(int truth, const char *words) { if (!truth) fault(words); }
static void note(char event) { size_t n = strlen(log_); if (n + 1 < sizeof log_) { log_[n] = event; log_[n + 1] = 0; } }

static int fails(const char *function)
{
    if (strcmp(failing, function)) return 0;
    errors[error_count++] = 0x0302;
    errors[error_count++] = failing_code;
    return 1;
}

void fake_reset(void)
{
    count = calls = error_count = with_device = enabled = in_frame = started = scheduled = running = 0;
    faults[0] = failing[0] = configuration[0] = log_[0] = 0;
    callback = NULL;
    calibration = CALIBRATED;
    update_from = frozen_until = 0;
    buttons = 0;
    snprintf(serial, sizeof serial, "1");
}
void fake_calibration(unsigned code, unsigned long accepts_from) { calibration = code, update_from = accepts_from; }
void fake_buttons(int pressed) { buttons = pressed; }
void fake_freeze(unsigned long until) { frozen_until = until; }
void fake_serial(const char *text) { snprintf(serial, sizeof serial, "%s", text); }
void fake_fail(const char *function, unsigned code) { snprintf(failing, sizeof failing, "%s", function); failing_code = code; }
const char *fake_faults(void) { return faults; }
const char *fake_log(void) { return log_; }
const char *fake_configuration(void) { return configuration; }
unsigned long fake_count(void) { return count; }
const double *fake_forces(void) { return &forces[0][0]; }

unsigned hdInitDevice(const char *name)
{
    note('I');
    if (fails("hdInitDevice") || !strcmp(failing, "nothing")) return 0xFFFFFFFF;
    snprintf(configuration, sizeof configuration, "%s", name ? name : "(default)");
    with_device = 1;
    return DEVICE;
}
void hdDisableDevice(unsigned device)
{
    note('D');
    need(with_device && device == DEVICE, "hdDisableDevice without a device");
    need(!running, "hdDisableDevice while the scheduler runs");
    with_device = 0;
}
void hdEnable(unsigned what)
{
    note('E');
    need(with_device && what == 0x4000, "hdEnable");
    if (!fails("hdEnable")) enabled = 1;
}
Error hdGetError(void)
{
    Error none = {0, 0, DEVICE};
    if (error_count) none.code = errors[--error_count];
    return none;
}
const char *hdGetErrorString(unsigned code) { return code == 0x0301 ? "device already\ninitiated" : NULL; }

void hdBeginFrame(unsigned device)
{
    need(device == DEVICE && !in_frame, "hdBeginFrame within a frame, or without a device");
    in_frame = 1;
    got = set_force = 0;
}
void hdEndFrame(unsigned device)
{
    need(device == DEVICE && in_frame && set_force, "hdEndFrame without a frame, or without a force");
    in_frame = 0;
    if (!strcmp(failing, "hdEndFrame") && !error_count) errors[error_count++] = failing_code;
}
void hdGetDoublev(unsigned what, double *values)
{
    need(in_frame && what == 0x2050, "hdGetDoublev outside a frame, or of something else");
    got = 1;
    values[0] = 0.5 * (double)(calls % 200);
    values[1] = -20;
    values[2] = 30;
    if (calls < frozen_until) values[0] = 0, values[1] = -110, values[2] = -35;
}
unsigned hdCheckCalibration(void)
{
    need(in_frame, "hdCheckCalibration outside a frame");
    return calibration != CALIBRATED && update_from && calls >= update_from ? 0x5001 : calibration;
}
void hdUpdateCalibration(unsigned style)
{
    need(!in_frame && style == INKWELL, "hdUpdateCalibration within a frame, or of another style");
    calibration = CALIBRATED;
}
void hdGetIntegerv(unsigned what, int *values)
{
    need(with_device && (what == 0x2555 || (what == 0x2000 && in_frame)), "hdGetIntegerv of something else");
    *values = what == 0x2000 ? buttons : 1 | INKWELL;
}
const char *hdGetString(unsigned what)
{
    need(with_device && what == 0x2504, "hdGetString of something else");
    return serial;
}
void hdSetDoublev(unsigned what, const double *values)
{
    need(in_frame && enabled && what == 0x2700, "hdSetDoublev outside a frame, or of something else");
    set_force = 1;
    memcpy(current, values, sizeof current);
    if (count < MOST) memcpy(forces[count++], values, sizeof current);
}

static void *loop(void *unused)
{
    struct timespec pause = {0, 1000000};
    (void)unused;
    while (started) {
        if (scheduled) {
            calls++;
            if (callback(user) == 0) scheduled = 0;
            need(!in_frame, "a frame without an end");
        }
        nanosleep(&pause, NULL);
    }
    return NULL;
}
unsigned long hdScheduleAsynchronous(Callback asked, void *pointer, unsigned short priority)
{
    note('S');
    need(with_device && enabled && !scheduled && asked && priority, "hdScheduleAsynchronous");
    callback = asked;
    user = pointer;
    if (!fails("hdScheduleAsynchronous")) scheduled = 1;
    return OPERATION;
}
void hdUnschedule(unsigned long operation)
{
    note('U');
    need(operation == OPERATION, "hdUnschedule of nothing");
    scheduled = 0;
}
void hdStartScheduler(void)
{
    note('R');
    if (fails("hdStartScheduler")) return;
    if (!strcmp(failing, "dead")) return; /* a driver that never calls */
    started = running = 1;
    pthread_create(&thread, NULL, loop, NULL);
}
void hdStopScheduler(void)
{
    note('T');
    started = 0;
    if (running) pthread_join(thread, NULL);
    running = 0;
}

/* -- a renderer that takes the place of touch_receiver_tick: it stores its inputs in the memory of the receiver -------- */

enum { TICKS, RELEASE, FAIL, SIZE, POSITION, TIMES = 100 }; /* numbers of eight bytes */
typedef struct { double x, y, z; } Vector;

Vector fake_tick(void *receiver, Vector position, long long now_ns)
{
    long long *numbers = receiver;
    double *doubles = receiver, size = doubles[SIZE];
    Vector force = {0, 0, 0};
    int fails_now = numbers[FAIL] && numbers[TICKS] == numbers[FAIL];
    numbers[TIMES + numbers[TICKS]++ % 256] = now_ns;
    memcpy(doubles + POSITION, &position, sizeof position);
    size += numbers[RELEASE] ? -0.1 : 0.1;
    size = size < 0 ? 0 : size > 2 ? 2 : size;
    doubles[SIZE] = size;
    force.x = fails_now ? size / 0.0 : size;
    force.y = -size;
    return force;
}
