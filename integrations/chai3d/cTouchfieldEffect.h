// A CHAI3D effect that renders a .touch file: proxy at walls, friction, damping, limits and ramp (c/touch_play.h).
#pragma once

#include "effects/CGenericEffect.h"

#include <atomic>
#include <memory>
#include <string>

// What the maker of a device states, and how the medium is rendered. See cHapticDeviceInfo for the first two.
struct cTouchfieldSettings {
    double m_forceMax = 0.0;         // N, greatest force of the device; 0: that of the medium
    double m_forceContinuous = 0.0;  // N, force that the device bears for long; 0: not stated
    double m_friction = -1.0;        // mu; below 0: that of the medium
    double m_damping = -1.0;         // N s/m everywhere; below 0: that of the medium, and in contact the stable value
    double m_coupling = -1.0;        // N/m, of a virtual coupling; 0: none; below 0: the stable value
    double m_wallStiffness = 0.0;    // N/m, of the proxy's walls; 0: measured in the medium
    double m_rate = 1000.0;          // Hz, of the haptic loop
    double m_speed = 1.0;            // seconds of the medium for one second
    bool m_loop = false;
    bool m_complete = false;         // no frame is left out, however late: for a simulation that waits with isReady
};

// The medium lies in the axes of the object that the effect is added to. A unit of the world is a metre, and a unit of force
// is a newton. The effect renders for one tool: the first that calls. A scene with two tools needs two effects.
//
// One haptic thread calls computeForce. Another thread, of the effect's own, decodes ahead. Orders (play, pause, seek, stop)
// come from one thread, which may be a third one.
class cTouchfieldEffect : public chai3d::cGenericEffect {
  public:
    // Opens a file and plays it from the first force on. If it fails, getError() says why, and there is no force.
    cTouchfieldEffect(chai3d::cGenericObject* a_parent, const std::string& a_filename,
                      const cTouchfieldSettings& a_settings = cTouchfieldSettings());
    ~cTouchfieldEffect() override;
    cTouchfieldEffect(const cTouchfieldEffect&) = delete;
    cTouchfieldEffect& operator=(const cTouchfieldEffect&) = delete;

    // One tick of the receiver; false if the force is zero. It does not wait or allocate.
    bool computeForce(const chai3d::cVector3d& a_toolPos, const chai3d::cVector3d& a_toolVel,
                      const unsigned int& a_toolID, chai3d::cVector3d& a_reactionForce) override;

    void play();
    void pause();                 // the medium stands, and its force stays
    void seek(double a_seconds);  // goes on at a time of the medium
    void stop();                  // brings the force to zero for ever, within the ramp
    bool isReleased() const;      // whether the force is zero after stop
    bool isOver() const;          // whether the medium has ended and the force is zero

    // Time of the medium at the latest tick, seconds.
    double getTime() const;

    // Time of the next tick by a clock of the caller's, seconds, from 0 on; it must not go back. For simulations; without it
    // the effect reads a monotonic clock. It is no time of the medium: see seek.
    void setClock(double a_seconds) { m_clock = a_seconds; }

    // Whether the next tick, at the time of setClock, finds its frames decoded. For the haptic thread of a simulation.
    bool isReady() const;

    // Why nothing is played, or nothing more, or that the thread that decodes hangs; an empty text if all is well.
    std::string getError() const;

  private:
    struct cReceiver;

    std::unique_ptr<cReceiver> m_receiver;
    std::string m_error;
    std::atomic<double> m_clock{-1.0};
    unsigned int m_toolID = 0;
    bool m_hasTool = false;
};
