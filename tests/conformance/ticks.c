/* The ticks of conformance/ticks, for tests: ticks FILE... compares each force, and torque, with the file. Prints the largest
   difference of each file, N or N m; exit status 1 if one is above 1e-9, 2 with a message if a file cannot be read or is of
   another layout of the receiver. */
#include "touch_render.h"

#include <stdio.h>
#include <stdlib.h>

#define TOLERANCE 1e-9

typedef struct { /* of a file, behind its eight first bytes */
    int64_t memory_bytes, receiver_bytes, layout_crc, pieces, ticks, numbers;
} ticks_header;

typedef struct { /* one tick; orientation and torque only with a tool */
    double before_offset, after_offset, blend;
    touch_vector position_m;
    double dt_s, is_release;
    touch_vector force_n;
    double orientation[4];
    touch_vector torque_nm;
} ticks_row;

enum { NUMBERS = 11, NUMBERS_OF_TOOL = 18, MAX_MEMORY_BYTES = 1 << 24 };

static const char *file_name = "";

static void refuse(const char *message) {
    fprintf(stderr, "%s: %s\n", file_name, message);
    exit(2);
}

static void get(void *to, size_t bytes, FILE *in) {
    if (fread(to, 1, bytes, in) != bytes) refuse("it ends early");
}

/* Read the header of a file of this layout. */
static ticks_header read_header(FILE *in) {
    char magic[8];
    ticks_header header;
    get(magic, sizeof magic, in);
    if (memcmp(magic, "TICKS002", 8)) refuse("no ticks, or those of another version: run conformance/make_ticks.py");
    get(&header, sizeof header, in);
    if (header.receiver_bytes != (int64_t)sizeof(touch_receiver))
        refuse("a receiver of another size: run conformance/make_ticks.py");
    if (header.memory_bytes < header.receiver_bytes || header.memory_bytes > MAX_MEMORY_BYTES || header.pieces < 0)
        refuse("sizes out of range");
    if (header.numbers != NUMBERS && header.numbers != NUMBERS_OF_TOOL) refuse("rows of an unknown kind");
    return header;
}

/* The memory of the receiver before its first tick: zeros, and pieces. */
static touch_receiver *read_memory(const ticks_header *header, FILE *in) {
    char *memory = (char *)calloc(1, (size_t)header->memory_bytes);
    if (!memory) refuse("no memory");
    for (int64_t n = 0; n < header->pieces; n++) {
        int64_t piece[2]; /* offset, size */
        get(piece, sizeof piece, in);
        if (piece[0] < 0 || piece[1] < 0 || piece[1] > header->memory_bytes - piece[0])
            refuse("a piece outside of its memory");
        get(memory + piece[0], (size_t)piece[1], in);
    }
    return (touch_receiver *)(void *)memory;
}

/* True if a frame begins at an offset, or none is there at this time. */
static int is_frame(const ticks_header *header, double offset) {
    return offset == 0.0 || (offset >= (double)header->receiver_bytes &&
                             offset <= (double)(header->memory_bytes - (int64_t)sizeof(touch_frame_header)));
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
    double largest = 0.0;
    FILE *in = fopen(name, "rb");
    file_name = name;
    if (!in) refuse("it cannot be opened");
    ticks_header header = read_header(in);
    touch_receiver *receiver = read_memory(&header, in);
    for (int64_t n = 0; n < header.ticks; n++) {
        ticks_row row;
        memset(&row, 0, sizeof row), get(&row, (size_t)header.numbers * sizeof(double), in);
        if (!is_frame(&header, row.before_offset) || !is_frame(&header, row.after_offset)) refuse("no frame at an offset");
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
