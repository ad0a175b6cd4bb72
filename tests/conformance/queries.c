/* Queries of touch_query.h, for tests: queries IN OUT. IN has groups: int64 bytes of a receiver's memory, offsets of two frames
   and a number of points; the memory; and float64 [points][4], the way from one frame to the other and a point, metres. OUT
   gets float64 [14] for each point: force, gradient and vibration. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef WITHOUT_VECTORS /* as a compiler without GNU's extensions has it */
#undef __GNUC__
#endif
#include "touch_query.h"

static int get(void *to, size_t bytes, FILE *in) { return fread(to, 1, bytes, in) == bytes; }

static void answer(const void *memory, const int64_t group[4], const double query[4], double row[14]) {
    touch_instant t = touch_instant_of(memory, group[1], group[2], query[0]);
    touch_vector point = touch_vector_of(query[1], query[2], query[3]), force = touch_force_at(&t, point);
    touch_matrix gradient = touch_gradient_at(&t, point, force);
    row[0] = force.x, row[1] = force.y, row[2] = force.z;
    for (int n = 0; n < 3; n++) {
        touch_vector g = gradient.row[n];
        row[3 + 3 * n] = g.x, row[4 + 3 * n] = g.y, row[5 + 3 * n] = g.z;
    }
    touch_vibration_at(&t, point, row + 12, row + 13);
}

int main(int count, char **words) {
    FILE *in = count == 3 ? fopen(words[1], "rb") : NULL, *out = in ? fopen(words[2], "wb") : NULL;
    int64_t group[4];
    if (!out) return 64;
    while (get(group, sizeof group, in)) {
        void *memory = malloc((size_t)group[0]);
        if (!memory || !get(memory, (size_t)group[0], in)) return 64;
        for (int64_t n = 0; n < group[3]; n++) {
            double query[4], row[14];
            if (!get(query, sizeof query, in)) return 64;
            answer(memory, group, query, row);
            if (fwrite(row, sizeof row, 1, out) != 1) return 64;
        }
        free(memory);
    }
    fclose(in);
    return fclose(out) ? 64 : 0;
}
