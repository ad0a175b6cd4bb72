/* What the library `touchfield` has beside c/touch.h: the force between two frames. */
#include "../../c/touch.h"

#include "../between.h"

void touchfield_force_between(const touch_frame *a, const touch_frame *b, double t, const double at[3], double most,
                              double newtons[3]);

void touchfield_force_between(const touch_frame *a, const touch_frame *b, double t, const double at[3], double most,
                              double newtons[3]) {
    touch_force_between(a, b, t, at, most, newtons);
}
