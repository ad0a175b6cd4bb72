/* The ticks of conformance/ticks, for tests: ticks FILE... compares each force, and torque, with the file. Prints the largest
   difference of each file, N or N m; exit status 1 if one is above 1e-9, or a file is none. */
#include "touch_render.h"

#include <stdio.h>
#include <stdlib.h>

#define TOLERANCE 1e-9

typedef struct { /* of a file, behind its eight first bytes */
    int64_t memory_bytes, pieces, ticks, numbers;
} ticks_header;

typedef struct { /* one tick; orientation and torque only with a tool */
    double before_offset, after_offset, blend;
    touch_vector position_m;
    double dt_s, is_release;
    touch_vector force_n;
    double orientation[4];
    touch_vector torque_nm;
} ticks_row;

enum { NUMBERS = 11, NUMBERS_OF_TOOL = 18 };

static void get(void *to, size_t bytes, FILE *in) {
    if (fread(to, 1, bytes, in) != bytes) exit(1);
}

/* The memory of the receiver before its first tick: zeros, and pieces. */
static touch_receiver *read_memory(const ticks_header *header, FILE *in) {
    char *memory = (char *)calloc(1, (size_t)header->memory_bytes);
    if (!memory) exit(1);
    for (int64_t n = 0; n < header->pieces; n++) {
        int64_t piece[2]; /* offset, size */
        get(piece, sizeof piece, in);
        if (piece[0] < 0 || piece[1] < 0 || piece[1] > header->memory_bytes - piece[0]) exit(1);
        get(memory + piece[0], (size_t)piece[1], in);
    }
    return (touch_receiver *)(void *)memory;
}

static double distance(touch_vector a, touch_vector b) {
    double size = touch_norm(touch_subtract(a, b));
    return size == size ? size : HUGE_VAL;
}

/* The largest difference of a tick. */
static double difference(touch_receiver *receiver, const ticks_row *row, int has_tool) {
    for (int n = 0; n < 4 && has_tool; n++) receiver->grip.orientation[n] = row->orientation[n];
    touch_vector force_n = row->is_release != 0.0
                               ? touch_release(receiver, row->dt_s)
                               : touch_tick(receiver, (int64_t)row->before_offset, (int64_t)row->after_offset, row->blend,
                                            row->position_m, row->dt_s);
    double largest = distance(force_n, row->force_n);
    return has_tool ? touch_fmax(largest, distance(receiver->state.torque.output, row->torque_nm)) : largest;
}

static double check(const char *name) {
    char magic[8];
    ticks_header header;
    double largest = 0.0;
    FILE *in = fopen(name, "rb");
    if (!in) exit(1);
    get(magic, sizeof magic, in), get(&header, sizeof header, in);
    if (memcmp(magic, "TICKS001", 8) || header.memory_bytes < (int64_t)sizeof(touch_receiver) || header.pieces < 0) exit(1);
    if (header.numbers != NUMBERS && header.numbers != NUMBERS_OF_TOOL) exit(1);
    touch_receiver *receiver = read_memory(&header, in);
    for (int64_t n = 0; n < header.ticks; n++) {
        ticks_row row;
        memset(&row, 0, sizeof row), get(&row, (size_t)header.numbers * sizeof(double), in);
        largest = touch_fmax(largest, difference(receiver, &row, header.numbers == NUMBERS_OF_TOOL));
    }
    free(receiver), fclose(in);
    return largest;
}

int main(int count, char **words) {
    int has_failed = count < 2;
    for (int n = 1; n < count; n++) {
        double largest = check(words[n]);
        printf("%s %.3g\n", words[n], largest);
        has_failed |= !(largest <= TOLERANCE);
    }
    return has_failed;
}
