// Orders of the CHAI3D effect, and its tools: effect_orders FILE.touch; 0 if all checks hold, else the line of the first
// that does not. The medium has several frames and does not loop; time is simulated.
#include "cTouchfieldEffect.h"

#include <chrono>
#include <cmath>
#include <cstdio>
#include <thread>

#define CHECK(condition) \
    if (!(condition)) return std::fprintf(stderr, "line %d: %s\n", __LINE__, #condition), 1

static int s_ticks = 0;

static bool tick(cTouchfieldEffect& a_effect, int a_count, unsigned int a_toolID = 0) {
    const chai3d::cVector3d origin(0.0, 0.0, 0.0);
    chai3d::cVector3d force(1.0, 1.0, 1.0);
    bool hasForce = false;
    for (int n = 0; n < a_count; n++) {
        a_effect.setClock(1e-3 * s_ticks++);
        while (!a_effect.isReady()) std::this_thread::sleep_for(std::chrono::microseconds(100));
        hasForce = a_effect.computeForce(origin, origin, a_toolID, force);
    }
    return hasForce || force.x() != 0.0 || force.y() != 0.0 || force.z() != 0.0;
}

static bool isAbout(double a_seconds, double a_expected) { return std::fabs(a_seconds - a_expected) < 1.5e-3; }

int main(int, char** a_words) {
    cTouchfieldEffect effect(nullptr, a_words[1]);
    CHECK(effect.getError().empty());
    tick(effect, 31, 5);
    CHECK(isAbout(effect.getTime(), 0.030));
    CHECK(!tick(effect, 10, 6));  // another tool: no force, and no time passes
    CHECK(isAbout(effect.getTime(), 0.030));
    effect.pause();
    tick(effect, 1, 5);
    const double paused = effect.getTime();
    tick(effect, 20, 5);
    CHECK(effect.getTime() == paused);
    effect.seek(0.1);
    effect.play();
    tick(effect, 11, 5);
    CHECK(isAbout(effect.getTime(), 0.110));
    CHECK(!effect.isOver() && !effect.isReleased());
    tick(effect, 200, 5);
    CHECK(effect.isOver());
    effect.stop();
    CHECK(!tick(effect, 30, 5));
    CHECK(effect.isReleased());

    cTouchfieldEffect missing(nullptr, "/nowhere.touch");
    CHECK(!missing.getError().empty() && missing.isReady() && missing.isReleased() && missing.isOver());
    missing.play(), missing.pause(), missing.seek(1.0), missing.stop();
    CHECK(!tick(missing, 3));
    return 0;
}
