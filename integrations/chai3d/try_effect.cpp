// Calls the effect as CHAI3D does. It reads positions, a line `x y z` in metres for each tick of 1 ms, and prints the force of
// each, newtons. At the end it stops the effect, and prints the forces on the way to zero. Time is simulated, or real with -r;
// the other options are those of cTouchfieldSettings.
#include "options.h"

#include <chrono>
#include <cstdio>
#include <thread>

typedef std::chrono::steady_clock cClock;

static const char* const c_usage =
    "try_effect [-p PEAK_N] [-m FRICTION] [-d DAMPING] [-c COUPLING] [-k WALL] [-l] [-r] FILE.touch\n";

// A loop of 1 kHz, in real or simulated time.
struct cLoop {
    cTouchfieldEffect& m_effect;
    bool m_isRealTime;
    int m_ticks;
    cClock::time_point m_start;

    chai3d::cVector3d tick(const chai3d::cVector3d& a_position) {
        const chai3d::cVector3d velocity(0.0, 0.0, 0.0);
        chai3d::cVector3d force(0.0, 0.0, 0.0);
        chai3d::cGenericEffect& base = m_effect;
        if (m_isRealTime) std::this_thread::sleep_until(m_start + std::chrono::milliseconds(m_ticks));
        else waitForFrames();
        base.computeForce(a_position, velocity, 0, force);
        m_ticks++;
        return force;
    }

    void waitForFrames() {
        m_effect.setClock(1e-3 * m_ticks);
        while (!m_effect.isReady()) std::this_thread::sleep_for(std::chrono::microseconds(100));
    }
};

static void print(const chai3d::cVector3d& a_force) {
    std::printf("%.17g %.17g %.17g\n", a_force.x(), a_force.y(), a_force.z());
}

int main(int a_count, char** a_words) {
    cTouchfieldSettings settings;
    bool isRealTime = false;
    const char* name = readOptions(a_count, a_words, settings, isRealTime);
    if (!name) return std::fputs(c_usage, stderr), 64;
    settings.m_complete = !isRealTime;
    cTouchfieldEffect effect(nullptr, name, settings);
    if (!effect.getError().empty()) return std::fprintf(stderr, "%s: %s\n", name, effect.getError().c_str()), 65;
    cLoop loop = {effect, isRealTime, 0, cClock::now()};
    chai3d::cVector3d position(0.0, 0.0, 0.0);
    double x, y, z;
    while (std::scanf("%lf %lf %lf", &x, &y, &z) == 3) {
        position.set(x, y, z);
        print(loop.tick(position));
    }
    for (effect.stop(); !effect.isReleased();) print(loop.tick(position));
    return 0;
}
