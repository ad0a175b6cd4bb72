/* Prints how the public structs of c/touch.h lie: `struct size`, and `struct.field offset size`. */
#include "../../c/touch.h"

#include <stddef.h>
#include <stdio.h>

#define WHOLE(type) printf("%s %u\n", #type, (unsigned)sizeof(type))
#define FIELD(type, field) \
    printf("%s.%s %u %u\n", #type, #field, (unsigned)offsetof(type, field), (unsigned)sizeof(((type *)0)->field))

static void small_structs(void) {
    WHOLE(touch_arena), FIELD(touch_arena, base), FIELD(touch_arena, size), FIELD(touch_arena, used);
    FIELD(touch_arena, peak);
    WHOLE(touch_grid), FIELD(touch_grid, shape), FIELD(touch_grid, spacing_m), FIELD(touch_grid, origin_m);
    WHOLE(touch_bytes), FIELD(touch_bytes, bytes), FIELD(touch_bytes, size);
    WHOLE(touch_field), FIELD(touch_field, grid), FIELD(touch_field, bricks), FIELD(touch_field, mask);
    FIELD(touch_field, table), FIELD(touch_field, forces_n);
    WHOLE(touch_part), FIELD(touch_part, field), FIELD(touch_part, rotation), FIELD(touch_part, position_m);
    FIELD(touch_part, velocity_m_s), FIELD(touch_part, spin_rad_s);
    WHOLE(touch_decoder), FIELD(touch_decoder, file), FIELD(touch_decoder, arena), FIELD(touch_decoder, kept);
    FIELD(touch_decoder, state), FIELD(touch_decoder, error);
}

int main(void) {
    small_structs();
    WHOLE(touch_file), FIELD(touch_file, data), FIELD(touch_file, size), FIELD(touch_file, grid);
    FIELD(touch_file, rate_hz), FIELD(touch_file, force_max_n), FIELD(touch_file, mapping_scale);
    FIELD(touch_file, mapping_offset_m), FIELD(touch_file, weber_fraction), FIELD(touch_file, force_threshold_n);
    FIELD(touch_file, friction), FIELD(touch_file, damping_n_s_per_m), FIELD(touch_file, frame_count);
    FIELD(touch_file, segment_count), FIELD(touch_file, object_count), FIELD(touch_file, device_type);
    FIELD(touch_file, axes), FIELD(touch_file, device_name), FIELD(touch_file, coder);
    FIELD(touch_file, parameters), FIELD(touch_file, index), FIELD(touch_file, error);
    WHOLE(touch_frame), FIELD(touch_frame, number), FIELD(touch_frame, parts), FIELD(touch_frame, is_placed);
    FIELD(touch_frame, part), FIELD(touch_frame, surface_damping_n_s_per_m), FIELD(touch_frame, force_max_n);
    FIELD(touch_frame, vibration);
    return 0;
}
