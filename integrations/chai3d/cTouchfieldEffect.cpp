#include "cTouchfieldEffect.h"

#include "../../c/touch_play.h"

#include <chrono>
#include <cstdint>
#include <fstream>
#include <iterator>
#include <new>
#include <thread>
#include <vector>

struct cTouchfieldEffect::cReceiver {
    std::vector<char> m_bytes;
    std::unique_ptr<std::uint8_t[]> m_memory;
    touch_play m_play;
    std::thread m_thread;
    std::atomic<bool> m_isClosing{false};

    ~cReceiver() {
        m_isClosing = true;
        if (m_thread.joinable()) m_thread.join();
    }

    const char* open(const std::string& a_filename, const cTouchfieldSettings& a_settings);
    void decodeAhead();
};

// Reads a file, lays out a receiver, and starts the thread that decodes; the error, or nullptr.
const char* cTouchfieldEffect::cReceiver::open(const std::string& a_filename, const cTouchfieldSettings& a_settings) {
    std::ifstream in(a_filename, std::ios::binary);
    m_bytes.assign(std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>());
    if (!in) return "the file cannot be read";
    touch_device device = {};
    device.force_max_n = a_settings.m_forceMax;
    device.force_continuous_n = a_settings.m_forceContinuous;
    if (touch_play_open(&m_play, m_bytes.data(), m_bytes.size(), &device)) return m_play.error;
    m_play.options.is_loop = a_settings.m_loop, m_play.options.speed = a_settings.m_speed;
    m_play.options.is_complete = a_settings.m_complete;
    touch_render_options& render = m_play.options.render;
    render.rate_hz = a_settings.m_rate, render.wall_n_per_m = a_settings.m_wallStiffness;
    render.friction = a_settings.m_friction < 0.0 ? TOUCH_OF_MEDIUM : a_settings.m_friction;
    render.damping_n_s_per_m = a_settings.m_damping < 0.0 ? TOUCH_OF_MEDIUM : a_settings.m_damping;
    render.coupling_n_per_m = a_settings.m_coupling < 0.0 ? TOUCH_STABLE : a_settings.m_coupling;
    m_memory.reset(new (std::nothrow) std::uint8_t[static_cast<std::size_t>(touch_play_room(&m_play))]);
    if (touch_play_start(&m_play, m_memory.get())) return m_play.error;
    touch_play_resume(&m_play);
    m_thread = std::thread(&cReceiver::decodeAhead, this);
    return nullptr;
}

void cTouchfieldEffect::cReceiver::decodeAhead() {
    while (!m_isClosing)
        if (!touch_play_decode(&m_play)) std::this_thread::sleep_for(std::chrono::milliseconds(1));
}

static std::int64_t nanoseconds(double a_clock) {
    if (a_clock >= 0.0) return static_cast<std::int64_t>(1e9 * a_clock + 0.5);
    const auto now = std::chrono::steady_clock::now().time_since_epoch();
    return std::chrono::duration_cast<std::chrono::nanoseconds>(now).count();
}

cTouchfieldEffect::cTouchfieldEffect(chai3d::cGenericObject* a_parent, const std::string& a_filename,
                                     const cTouchfieldSettings& a_settings)
    : chai3d::cGenericEffect(a_parent), m_receiver(new cReceiver) {
    const char* error = m_receiver->open(a_filename, a_settings);
    if (!error) return;
    m_error = error;
    m_receiver.reset();
}

cTouchfieldEffect::~cTouchfieldEffect() = default;

bool cTouchfieldEffect::computeForce(const chai3d::cVector3d& a_toolPos, const chai3d::cVector3d&,
                                     const unsigned int& a_toolID, chai3d::cVector3d& a_reactionForce) {
    a_reactionForce.zero();
    if (!m_hasTool) m_toolID = a_toolID, m_hasTool = true;
    if (!m_receiver || a_toolID != m_toolID) return false;
    const touch_vector position = touch_vector_of(a_toolPos.x(), a_toolPos.y(), a_toolPos.z());
    const touch_vector force = touch_receiver_tick(m_receiver->m_play.receiver, position, nanoseconds(m_clock));
    a_reactionForce.set(force.x, force.y, force.z);
    return !touch_is_zero(force);
}

void cTouchfieldEffect::play() {
    if (m_receiver) touch_play_resume(&m_receiver->m_play);
}

void cTouchfieldEffect::pause() {
    if (m_receiver) touch_play_pause(&m_receiver->m_play);
}

void cTouchfieldEffect::seek(double a_seconds) {
    if (m_receiver) touch_play_seek(&m_receiver->m_play, a_seconds);
}

void cTouchfieldEffect::stop() {
    if (m_receiver) touch_play_stop(&m_receiver->m_play);
}

bool cTouchfieldEffect::isReleased() const {
    return !m_receiver || touch_shared(&m_receiver->m_play.receiver->clock.is_released);
}

bool cTouchfieldEffect::isOver() const { return !m_receiver || touch_play_is_over(&m_receiver->m_play); }

double cTouchfieldEffect::getTime() const { return m_receiver ? m_receiver->m_play.receiver->clock.media_s : 0.0; }

bool cTouchfieldEffect::isReady() const {
    return !m_receiver || touch_play_is_ready(&m_receiver->m_play, nanoseconds(m_clock));
}

std::string cTouchfieldEffect::getError() const {
    return m_receiver ? touch_play_error(&m_receiver->m_play) : m_error;
}
