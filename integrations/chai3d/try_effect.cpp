// Asks the effect as CHAI3D does: try_effect FILE.touch [PEAK_N], then lines `seconds x y z`; prints forces, newtons.
#include "cTouchfieldEffect.h"

#include <cstdio>
#include <cstdlib>

int main(int count, char** words) {
    if (count < 2 || count > 3) return std::fprintf(stderr, "try_effect FILE.touch [PEAK_N]\n"), 64;
    cTouchfieldEffect effect(nullptr, words[1]);
    if (!effect.getError().empty()) return std::fprintf(stderr, "%s: %s\n", words[1], effect.getError().c_str()), 65;
    if (count == 3) effect.setForceMax(std::atof(words[2]));
    chai3d::cGenericEffect& asked = effect;
    double seconds, x, y, z;
    while (std::scanf("%lf %lf %lf %lf", &seconds, &x, &y, &z) == 4) {
        const chai3d::cVector3d position(x, y, z), velocity(0.0, 0.0, 0.0);
        chai3d::cVector3d force(0.0, 0.0, 0.0);
        effect.setTime(seconds);
        asked.computeForce(position, velocity, 0, force);  // tells the decoder where it is
        while (!effect.isReady()) {
            std::this_thread::sleep_for(std::chrono::microseconds(100));
            asked.computeForce(position, velocity, 0, force);
        }
        asked.computeForce(position, velocity, 0, force);
        std::printf("%.9g %.9g %.9g\n", force.x(), force.y(), force.z());
    }
    return 0;
}
