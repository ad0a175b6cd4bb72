// A scene of CHAI3D with a simulated device: the loop of CHAI3D's own examples, without a window. It needs CHAI3D, built.
// It reads positions, a line `x y z` in metres of the medium for each tick of 1 ms, moves the device there, and prints the
// force that the device receives, newtons, in the axes of the medium. Time is simulated. The object is turned and moved,
// as objects of a world are. At the end the effect is stopped, and the forces on the way to zero are printed, too.
#include "options.h"

#include "devices/CGenericHapticDevice.h"
#include "tools/CToolCursor.h"
#include "world/CWorld.h"

#include <chrono>
#include <cstdio>
#include <thread>

using namespace chai3d;

static const char* const c_usage = "scene [-p PEAK_N] [-m FRICTION] [-d DAMPING] [-c COUPLING] [-k WALL] [-l] FILE.touch\n";

// A device that is where the program puts it.
class cSimulatedDevice : public cGenericHapticDevice {
  public:
    cVector3d m_position, m_force;

    explicit cSimulatedDevice(double a_forceMax) {
        m_specifications.m_maxLinearForce = a_forceMax;
        m_specifications.m_sensedPosition = m_specifications.m_actuatedPosition = true;
        m_deviceAvailable = true;
    }
    bool open() override { return m_deviceReady = true; }
    bool close() override { return m_deviceReady = false, true; }
    bool getPosition(cVector3d& a_position) override {
        a_position = m_position;
        return m_deviceReady;
    }
    bool setForceAndTorqueAndGripperForce(const cVector3d& a_force, const cVector3d&, double) override {
        m_force = a_force;
        return m_deviceReady;
    }
};

// A world with an object that has the effect, and a tool.
struct cScene {
    cWorld m_world;
    cGenericObject* m_object = new cGenericObject();  // the world frees its children
    cToolCursor* m_tool = new cToolCursor(&m_world);
    std::shared_ptr<cSimulatedDevice> m_device;
    cTouchfieldEffect* m_effect;  // the object frees its effects
    int m_ticks = 0;

    cScene(const char* a_name, const cTouchfieldSettings& a_settings)
        : m_device(std::make_shared<cSimulatedDevice>(a_settings.m_forceMax)),
          m_effect(new cTouchfieldEffect(m_object, a_name, a_settings)) {
        m_world.addChild(m_object);
        m_world.addChild(m_tool);
        m_object->setLocalPos(0.02, -0.01, 0.03);
        m_object->rotateAboutGlobalAxisDeg(cVector3d(0.0, 0.0, 1.0), 30.0);
        m_object->setHapticEnabled(true);
        m_object->addEffect(m_effect);
        m_tool->setHapticDevice(m_device);
        m_tool->setRadius(0.001);
        m_tool->start();
    }
    ~cScene() { m_tool->stop(); }

    cVector3d tick(const cVector3d& a_position) {
        m_effect->setClock(1e-3 * m_ticks++);
        while (!m_effect->isReady()) std::this_thread::sleep_for(std::chrono::microseconds(100));
        m_device->m_position = m_object->getLocalPos() + m_object->getLocalRot() * a_position;
        m_world.computeGlobalPositions(true);
        m_tool->updateFromDevice();
        m_tool->computeInteractionForces();
        m_tool->applyToDevice();
        return cTranspose(m_object->getLocalRot()) * m_device->m_force;
    }
};

static void print(const cVector3d& a_force) {
    std::printf("%.17g %.17g %.17g\n", a_force.x(), a_force.y(), a_force.z());
}

int main(int a_count, char** a_words) {
    cTouchfieldSettings settings;
    bool isRealTime = false;
    const char* name = readOptions(a_count, a_words, settings, isRealTime);
    if (!name || isRealTime) return std::fputs(c_usage, stderr), 64;
    settings.m_complete = true;
    cScene scene(name, settings);
    const std::string error = scene.m_effect->getError();
    if (!error.empty()) return std::fprintf(stderr, "%s: %s\n", name, error.c_str()), 65;
    cVector3d position(0.0, 0.0, 0.0);
    double x, y, z;
    while (std::scanf("%lf %lf %lf", &x, &y, &z) == 3) {
        position.set(x, y, z);
        print(scene.tick(position));
    }
    for (scene.m_effect->stop(); !scene.m_effect->isReleased();) print(scene.tick(position));
    return 0;
}
