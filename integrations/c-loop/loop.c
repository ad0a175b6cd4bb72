/* A haptic loop of one's own around c/touch.h: the force of a .touch file at a hand, 1000 times a second.

       loop [-s SECONDS] [-p PEAK_N] [-x SPEED] [-i] FILE.touch

   -s how long (2); -p what the device can bear; -x how fast the medium plays (1); -i the hand is read, a line
   `x y z` in metres for each tick, else it is simulated. When the loop has ended each tick is printed: the frame,
   where the hand was, its force; and to stderr how late the loop was at worst.

   The loop never waits and never allocates. A thread decodes ahead into four arenas; it tells the loop one number,
   the newest frame, and the loop tells it another, the oldest frame that it still feels. */
#define _POSIX_C_SOURCE 200809L
#define TOUCH_IMPLEMENTATION
#include "../../c/touch.h"

#include "../between.h"

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

enum { ARENAS = 4, LINES = 4096, TICK_NS = 1000000 };

typedef struct {
    double frame, at[3], newtons[3];
} tick_row;

typedef struct {
    touch_file file;
    touch_decoder decoder[2]; /* of even and odd segments: bodies that change live in one until it seeks again */
    touch_arena arena[ARENAS];
    touch_frame frame[ARENAS];
    double line[LINES][3], seconds, speed, peak_n;
    int64_t newest, oldest, written, taken; /* frames, then lines: each is written by one thread */
    int reads_lines, is_read, is_over, code;
    int64_t late_ns, held;
} player;

#define LOAD(place) __atomic_load_n(&(place), __ATOMIC_ACQUIRE)
#define STORE(place, value) __atomic_store_n(&(place), value, __ATOMIC_RELEASE)

/* Until a number is at least so large, or all is over; not for the loop. */
static int wait_for(player *p, const int64_t *number, int64_t least) {
    const struct timespec pause = {0, TICK_NS / 4};
    while (LOAD(*number) < least && !LOAD(p->is_over) && !LOAD(p->code)) nanosleep(&pause, 0);
    return LOAD(*number) >= least;
}

static void *decode_ahead(void *given) {
    player *p = (player *)given;
    int64_t n = 0, before = 0, first = 0;
    uint32_t segment;
    int code = TOUCH_OK;
    for (segment = 0; segment < p->file.segment_count && !code; segment++, before = first) {
        touch_decoder *decoder = p->decoder + (segment & 1);
        if (!wait_for(p, &p->oldest, before)) return 0; /* nothing of the segment before the last one is felt */
        code = touch_seek(decoder, segment), first = n;
        while (!code && wait_for(p, &p->oldest, n - ARENAS + 1)) {
            touch_arena *arena = p->arena + n % ARENAS;
            arena->used = 0, code = touch_next(decoder, arena, p->frame + n % ARENAS);
            if (!code) STORE(p->newest, n), n++;
        }
        if (code == TOUCH_END) code = TOUCH_OK;
    }
    STORE(p->code, code);
    return 0;
}

static void *read_lines(void *given) {
    player *p = (player *)given;
    double *at = p->line[0];
    int64_t n = 0;
    while (wait_for(p, &p->taken, n - LINES + 1) && scanf("%lf %lf %lf", at, at + 1, at + 2) == 3)
        STORE(p->written, ++n), at = p->line[n % LINES];
    STORE(p->is_read, 1);
    return 0;
}

/* Where the hand is in a tick; 0 when no line will follow. It stays where it is until its next line. */
static int hand(player *p, int64_t tick, double at[3]) {
    const touch_grid *g = &p->file.grid;
    int n, is_read = LOAD(p->is_read);
    int64_t taken = p->taken;
    for (n = 0; n < 3 && !p->reads_lines; n++) /* a hand that wanders through the medium */
        at[n] = g->origin_m[n] +
                g->spacing_m[n] * (g->shape[n] - 1) * (0.5 + 0.45 * sin((2 + 1.3 * n) * 1e-3 * (double)tick));
    if (!p->reads_lines) return 1;
    if (taken == LOAD(p->written)) return !is_read;
    memcpy(at, p->line[taken % LINES], 3 * sizeof *at);
    STORE(p->taken, taken + 1);
    return 1;
}

/* The loop itself; returns its ticks. */
static int64_t loop(player *p, tick_row *rows, int64_t ticks) {
    const double last = p->file.frame_count - 1.0;
    struct timespec due, now;
    double at[3] = {NAN, NAN, NAN}; /* where there is no force */
    int64_t tick;
    clock_gettime(CLOCK_MONOTONIC, &due);
    for (tick = 0; tick < ticks && hand(p, tick, at) && !LOAD(p->code); tick++) {
        double frame = (double)tick * 1e-9 * TICK_NS * p->speed * p->file.rate_hz;
        int64_t newest = LOAD(p->newest), late_ns, a;
        if (frame > last) frame = last;
        if (frame > (double)newest) frame = (double)newest, p->held++; /* the decoder is late: its newest is felt */
        a = (int64_t)frame, STORE(p->oldest, a);
        touch_force_between(p->frame + a % ARENAS, p->frame + (a < newest ? a + 1 : a) % ARENAS, frame - (double)a,
                            at, p->peak_n, rows[tick].newtons); /* here a device would be given its force */
        rows[tick].frame = frame, memcpy(rows[tick].at, at, sizeof at);
        due.tv_nsec += TICK_NS;
        if (due.tv_nsec >= 1000000000) due.tv_nsec -= 1000000000, due.tv_sec++;
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, 0)) {}
        clock_gettime(CLOCK_MONOTONIC, &now);
        late_ns = (int64_t)(now.tv_sec - due.tv_sec) * 1000000000 + (now.tv_nsec - due.tv_nsec);
        if (late_ns > p->late_ns) p->late_ns = late_ns;
    }
    return tick;
}

/* Opens a file and gives its decoders and frames all the memory that they will ever need. */
static int prepare(player *p, const char *name) {
    FILE *in = fopen(name, "rb");
    uint64_t own, each;
    uint8_t *bytes, *memory;
    long size;
    int n;
    if (!in) return fprintf(stderr, "%s: cannot be opened\n", name), 64;
    fseek(in, 0, SEEK_END), size = ftell(in), rewind(in);
    bytes = (uint8_t *)malloc((size_t)size + 1);
    if (!bytes || fread(bytes, 1, (size_t)size, in) != (size_t)size) return fprintf(stderr, "cannot be read\n"), 64;
    fclose(in);
    if (touch_open(&p->file, bytes, (uint64_t)size)) return fprintf(stderr, "%s: %s\n", name, p->file.error), 65;
    touch_room(&p->file, &own, &each);
    memory = (uint8_t *)malloc(2 * own + ARENAS * each);
    if (!memory) return fprintf(stderr, "there is not memory for all that the file may tell\n"), 64;
    for (n = 0; n < 2; n++)
        if (touch_start(p->decoder + n, &p->file, touch_arena_of(memory + (uint64_t)n * own, own)))
            return fprintf(stderr, "%s: %s\n", name, p->decoder[n].error), 65;
    for (n = 0; n < ARENAS; n++) p->arena[n] = touch_arena_of(memory + 2 * own + (uint64_t)n * each, each);
    if (!(p->peak_n < p->file.force_max_n)) p->peak_n = p->file.force_max_n;
    return 0;
}

int main(int count, char **words) {
    static player p; /* its memory and what was read live as long as the program */
    pthread_t decoder, reader;
    tick_row *rows;
    int64_t ticks, n;
    int option, code;
    p.seconds = 2, p.speed = 1, p.peak_n = HUGE_VAL, p.newest = -1;
    while ((option = getopt(count, words, "s:p:x:i")) != -1) {
        if (option == 's') p.seconds = atof(optarg);
        if (option == 'p') p.peak_n = atof(optarg);
        if (option == 'x') p.speed = atof(optarg);
        if (option == 'i') p.reads_lines = 1;
        if (option == '?') return 64;
    }
    if (optind + 1 != count || !(p.seconds > 0 && p.seconds <= 3600 && p.speed >= 0 && p.peak_n > 0))
        return fprintf(stderr, "loop [-s SECONDS] [-p PEAK_N] [-x SPEED] [-i] FILE.touch\n"), 64;
    code = prepare(&p, words[optind]);
    if (code) return code;
    rows = (tick_row *)calloc((size_t)(p.seconds * 1000), sizeof *rows);
    if (!rows || pthread_create(&decoder, 0, decode_ahead, &p)) return fprintf(stderr, "no memory or thread\n"), 64;
    if (p.reads_lines && pthread_create(&reader, 0, read_lines, &p)) return fprintf(stderr, "no thread\n"), 64;
    wait_for(&p, &p.newest, 0);
    ticks = loop(&p, rows, (int64_t)(p.seconds * 1000));
    STORE(p.is_over, 1), pthread_join(decoder, 0);
    for (n = 0; n < ticks; n++)
        printf("%.9g %.9g %.9g %.9g %.9g %.9g %.9g\n", rows[n].frame, rows[n].at[0], rows[n].at[1], rows[n].at[2],
               rows[n].newtons[0], rows[n].newtons[1], rows[n].newtons[2]);
    free(rows);
    fprintf(stderr, "%lld ticks, the latest by %.3f ms; in %lld the decoder was late\n", (long long)ticks,
            1e-6 * (double)p.late_ns, (long long)p.held);
    for (n = 0; n < 2 && p.code; n++)
        if (*p.decoder[n].error) fprintf(stderr, "%s: %s\n", words[optind], p.decoder[n].error);
    return p.code;
}
