/* Measures nanoseconds of single queries of the force, for `bench_c`: c_query FILE.touch COUNT. Prints the median
   and the 99.9th percentile, less what reading the clock takes, at random points within the lattice of the first
   frame. */
#define TOUCH_IMPLEMENTATION
#include "touch.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static uint64_t now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

static int less(const void *a, const void *b) {
    uint64_t one = *(const uint64_t *)a, two = *(const uint64_t *)b;
    return (one > two) - (one < two);
}

int main(int count, char **words) {
    FILE *in = count == 3 ? fopen(words[1], "rb") : NULL;
    if (!in || fseek(in, 0, SEEK_END)) return 64;
    size_t size = (size_t)ftell(in), queries = (size_t)atol(words[2]);
    uint8_t *bytes = malloc(size);
    uint64_t room, each, *took = malloc(2 * queries * sizeof *took), state = 1;
    rewind(in);
    if (!bytes || !took || fread(bytes, 1, size, in) != size) return 64;
    touch_file file;
    touch_decoder decoder;
    touch_frame frame;
    if (touch_open(&file, bytes, size)) return 65;
    touch_room(&file, &room, &each);
    touch_arena arena = touch_arena_of(malloc(each), each);
    if (touch_start(&decoder, &file, touch_arena_of(malloc(room), room)) || touch_seek(&decoder, 0)) return 65;
    if (touch_next(&decoder, &arena, &frame)) return 65;
    double sum = 0;
    for (size_t i = 0; i < 2 * queries; i++) {
        double p[3], f[3] = {0, 0, 0};
        for (int n = 0; n < 3; n++) {
            state = state * 6364136223846793005u + 1442695040888963407u;
            p[n] = file.grid.origin_m[n] + (double)(state >> 40) / 16777216.0 * file.grid.spacing_m[n] * file.grid.shape[n];
        }
        uint64_t began = now();
        if (i < queries) touch_force(&frame, p[0], p[1], p[2], f);
        took[i] = now() - began, sum += f[0];
    }
    qsort(took, queries, sizeof *took, less), qsort(took + queries, queries, sizeof *took, less);
    uint64_t clock = took[queries + queries / 2];
    printf("%ld %ld %g\n", (long)(took[queries / 2] - clock), (long)(took[queries - queries / 1000] - clock), sum);
    return 0;
}
