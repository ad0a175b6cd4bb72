// A CHAI3D effect whose force is that of a .touch file where the tool is.
#pragma once

#include "../../c/touch.h"
#include "effects/CGenericEffect.h"

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <thread>
#include <vector>

// The medium lies in the axes of the object that the effect is added to; a unit of the world is a metre, and of its
// forces a newton. One haptic thread calls computeForce; another one, of the effect's own, decodes ahead.
class cTouchfieldEffect : public chai3d::cGenericEffect {
  public:
    // Opens a file. If it cannot, getError() tells why, and there never is a force.
    cTouchfieldEffect(chai3d::cGenericObject* a_parent, const std::string& a_filename);
    ~cTouchfieldEffect() override;
    cTouchfieldEffect(const cTouchfieldEffect&) = delete;
    cTouchfieldEffect& operator=(const cTouchfieldEffect&) = delete;

    // Never waits and never allocates; false where there is no force.
    bool computeForce(const chai3d::cVector3d& a_toolPos, const chai3d::cVector3d& a_toolVel,
                      const unsigned int& a_toolID, chai3d::cVector3d& a_reactionForce) override;

    // The time of the medium, seconds, which must not go back. Without it, time runs from the first force on.
    void setTime(double a_seconds) { m_time = a_seconds; }
    // Whether all that this time needs is decoded; else the newest frame there is would be felt.
    bool isReady() const { return m_isOver || frameNow() <= static_cast<double>(m_newest.load()); }
    // The most that the device can bear, newtons, if that is less than what the medium says.
    void setForceMax(double a_newtons) { m_most = a_newtons; }
    const std::string& getError() const { return m_error; }

  private:
    static constexpr std::int64_t c_slots = 4;

    bool open(const std::string& a_filename);
    bool waitFor(std::int64_t a_frame) const;
    void decodeAhead();
    double frameNow() const;

    std::vector<std::uint8_t> m_bytes;
    std::unique_ptr<std::uint8_t[]> m_memory;
    touch_file m_file = {};
    touch_decoder m_decoder[2] = {};  // of even and odd segments: bodies that change live in one until it seeks again
    touch_arena m_arena[c_slots] = {};
    touch_frame m_frame[c_slots] = {};
    std::string m_error;
    std::atomic<std::int64_t> m_newest{-1}, m_oldest{0};  // frames: decoded, and still felt
    std::atomic<bool> m_isOver{false};
    std::atomic<double> m_time{-1.0}, m_most{1e300};
    std::chrono::steady_clock::time_point m_start;
    bool m_isStarted = false;
    std::thread m_thread;
};
