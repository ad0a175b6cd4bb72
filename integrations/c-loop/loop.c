/* A haptic loop of one's own around c/touch_play.h: the force of a .touch file on a hand, 1000 times a second, with a proxy at
   walls, friction, limits and ramp.

       loop [-s SECONDS] [-p PEAK_N] [-m FRICTION] [-k WALL] [-x SPEED] [-l] [-t] [-i] FILE.touch

   -s how long (2); -p the greatest force of the device (what the medium states); -m friction (the medium's); -k the stiffness
   of walls, N/m (the medium's); -x how fast the medium plays (1); -l it plays again and again; -t simulated time: as fast as
   possible, and each frame is waited for; -i the hand is read, a line `x y z` in metres for each tick, else it is simulated.
   At the end each tick is printed: media time, position and force; and to stderr how late the loop was at worst.

   The loop never waits for another thread and never allocates. */
#define _POSIX_C_SOURCE 200809L
#define TOUCH_IMPLEMENTATION
#include "../../c/touch_play.h"

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

enum { MAX_TICKS = 3600000 };

typedef struct {
    double media_s;
    touch_vector position_m, force_n;
} tick_row;

typedef struct {
    double seconds, peak_n, friction, wall_n_per_m, speed;
    int is_loop, is_simulated, reads_lines;
} loop_options;

static touch_play play; /* lives as long as the program, as does its memory */

static void nap(void) {
    const struct timespec pause = {0, 500000};
    nanosleep(&pause, NULL);
}

static void *decode_ahead(void *unused) {
    while (!touch_shared(&play.receiver->clock.is_released))
        if (!touch_play_decode(&play)) nap();
    return unused;
}

/* Where the hand is in a tick; 0 when no line will follow. */
static int hand(const loop_options *options, int64_t tick, touch_vector *position_m) {
    const touch_grid *g = &play.file.grid;
    double at[3];
    if (options->reads_lines) return scanf("%lf %lf %lf", &position_m->x, &position_m->y, &position_m->z) == 3;
    for (int n = 0; n < 3; n++) /* a hand that wanders through the medium */
        at[n] = g->origin_m[n] +
                g->spacing_m[n] * (g->shape[n] - 1) * (0.5 + 0.45 * sin((2 + 1.3 * n) * 1e-3 * (double)tick));
    *position_m = touch_vector_of(at[0], at[1], at[2]);
    return 1;
}

static int64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

static void wait_until(int64_t deadline_ns) {
    struct timespec due;
    due.tv_sec = (time_t)(deadline_ns / 1000000000), due.tv_nsec = (long)(deadline_ns % 1000000000);
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL)) {}
}

/* One tick: here a device would be given its force. */
static touch_vector tick_at(const loop_options *options, touch_vector position_m, int64_t tick) {
    touch_receiver *receiver = play.receiver;
    if (options->is_simulated) {
        int64_t needed = receiver->clock.needs & (((int64_t)1 << TOUCH_FRAME_BITS) - 1);
        while (play.next < needed + 3 && touch_play_decode(&play)) {}
        return touch_receiver_tick(receiver, position_m, tick * receiver->layout.tick_ns);
    }
    if (tick) wait_until(receiver->clock.deadline_ns);
    return touch_receiver_tick(receiver, position_m, now_ns());
}

/* The loop itself, and the way to zero after it; its ticks. */
static int64_t loop(const loop_options *options, tick_row *rows, int64_t ticks) {
    touch_vector position_m = touch_zero();
    int64_t tick = 0;
    for (; tick < ticks && hand(options, tick, &position_m); tick++) {
        touch_vector force_n = tick_at(options, position_m, tick);
        rows[tick].media_s = play.receiver->clock.media_s;
        rows[tick].position_m = position_m, rows[tick].force_n = force_n;
    }
    touch_play_stop(&play);
    for (int64_t n = tick; !play.receiver->clock.is_released; n++) (void)tick_at(options, position_m, n);
    return tick;
}

static uint8_t *contents(const char *name, uint64_t *size) {
    FILE *in = fopen(name, "rb");
    if (!in) return NULL;
    fseek(in, 0, SEEK_END);
    long length = ftell(in);
    uint8_t *bytes = (uint8_t *)malloc((size_t)length + 1);
    rewind(in);
    *size = bytes ? fread(bytes, 1, (size_t)length, in) : 0;
    fclose(in);
    return bytes;
}

/* Open a file, and lay out a receiver for the device. */
static int prepare(const char *name, const loop_options *options) {
    uint64_t size = 0;
    const uint8_t *bytes = contents(name, &size);
    if (!bytes) return fprintf(stderr, "%s: cannot be read\n", name), 64;
    touch_device device = {0};
    device.force_max_n = options->peak_n;
    if (touch_play_open(&play, bytes, size, &device)) return fprintf(stderr, "%s: %s\n", name, play.error), 65;
    play.options.is_loop = options->is_loop, play.options.speed = options->speed;
    play.options.is_simulated = options->is_simulated;
    play.options.render.wall_n_per_m = options->wall_n_per_m;
    if (options->friction >= 0.0) play.options.render.friction = options->friction;
    void *memory = malloc(touch_play_room(&play));
    if (touch_play_start(&play, memory)) return fprintf(stderr, "%s: %s\n", name, play.error), 65;
    touch_play_resume(&play);
    return 0;
}

static int read_options(int count, char **words, loop_options *options) {
    int option;
    options->seconds = 2.0, options->speed = 1.0, options->friction = -1.0;
    while ((option = getopt(count, words, "s:p:m:k:x:lti")) != -1) {
        if (option == 's') options->seconds = atof(optarg);
        if (option == 'p') options->peak_n = atof(optarg);
        if (option == 'm') options->friction = atof(optarg);
        if (option == 'k') options->wall_n_per_m = atof(optarg);
        if (option == 'x') options->speed = atof(optarg);
        if (option == 'l') options->is_loop = 1;
        if (option == 't') options->is_simulated = 1;
        if (option == 'i') options->reads_lines = 1;
        if (option == '?') return 0;
    }
    return optind + 1 == count && options->seconds > 0 && options->seconds <= 1e-3 * MAX_TICKS && options->speed > 0;
}

int main(int count, char **words) {
    loop_options options = {0, 0, 0, 0, 0, 0, 0, 0};
    pthread_t decoder;
    if (!read_options(count, words, &options))
        return fputs("loop [-s SECONDS] [-p PEAK_N] [-m FRICTION] [-k WALL] [-x SPEED] [-l] [-t] [-i] FILE\n", stderr), 64;
    int code = prepare(words[optind], &options);
    if (code) return code;
    int64_t ticks = (int64_t)(options.seconds * 1000 + 0.5);
    tick_row *rows = (tick_row *)calloc((size_t)ticks, sizeof *rows);
    if (!rows || (!options.is_simulated && pthread_create(&decoder, NULL, decode_ahead, NULL)))
        return fprintf(stderr, "no memory, or no thread\n"), 64;
    ticks = loop(&options, rows, ticks);
    if (!options.is_simulated) pthread_join(decoder, NULL);
    for (int64_t n = 0; n < ticks; n++)
        printf("%.17g %.17g %.17g %.17g %.17g %.17g %.17g\n", rows[n].media_s, rows[n].position_m.x, rows[n].position_m.y,
               rows[n].position_m.z, rows[n].force_n.x, rows[n].force_n.y, rows[n].force_n.z);
    free(rows);
    const touch_counts *counts = &play.receiver->counts;
    fprintf(stderr, "%lld ticks, the latest by %.3f ms; in %lld a frame was late\n", (long long)ticks,
            1e-6 * (double)counts->worst_lateness_ns, (long long)counts->stalled_ticks);
    if (counts->silences) fprintf(stderr, "in %lld ticks the decoder was silent\n", (long long)counts->silent_ticks);
    if (play.code) fprintf(stderr, "%s: %s\n", words[optind], play.error);
    return play.code;
}
