#include "cTouchfieldEffect.h"

#include "../between.h"

#include <algorithm>
#include <fstream>
#include <iterator>
#include <new>

cTouchfieldEffect::cTouchfieldEffect(chai3d::cGenericObject* a_parent, const std::string& a_filename)
    : chai3d::cGenericEffect(a_parent) {
    if (open(a_filename)) m_thread = std::thread(&cTouchfieldEffect::decodeAhead, this);
}

cTouchfieldEffect::~cTouchfieldEffect() {
    m_isOver = true;
    if (m_thread.joinable()) m_thread.join();
}

bool cTouchfieldEffect::open(const std::string& a_filename) {
    std::ifstream in(a_filename, std::ios::binary);
    m_bytes.assign(std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>());
    if (!in) {
        m_error = "the file cannot be read";
        return false;
    }
    if (touch_open(&m_file, m_bytes.data(), m_bytes.size()) != TOUCH_OK) {
        m_error = m_file.error;
        return false;
    }
    std::uint64_t own = 0, each = 0;
    touch_room(&m_file, &own, &each);
    m_memory.reset(new (std::nothrow) std::uint8_t[2 * own + c_slots * each]);
    if (!m_memory) {
        m_error = "there is not memory for all that the file may tell";
        return false;
    }
    for (std::uint64_t n = 0; n < 2; n++)
        if (touch_start(&m_decoder[n], &m_file, touch_arena_of(&m_memory[n * own], own)) != TOUCH_OK) {
            m_error = m_decoder[n].error;
            return false;
        }
    for (std::uint64_t n = 0; n < c_slots; n++) m_arena[n] = touch_arena_of(&m_memory[2 * own + n * each], each);
    return true;
}

// Until the effect needs no frame before this one; false when it ends.
bool cTouchfieldEffect::waitFor(std::int64_t a_frame) const {
    while (m_oldest < a_frame && !m_isOver) std::this_thread::sleep_for(std::chrono::microseconds(250));
    return !m_isOver;
}

void cTouchfieldEffect::decodeAhead() {
    std::int64_t n = 0, before = 0;
    for (std::uint32_t segment = 0; segment < m_file.segment_count; segment++) {
        touch_decoder* decoder = &m_decoder[segment & 1];
        if (!waitFor(before)) return;  // nothing of the segment before the last one is felt any longer
        before = n;
        int code = touch_seek(decoder, segment);
        while (code == TOUCH_OK) {
            if (!waitFor(n - c_slots + 1)) return;
            m_arena[n % c_slots].used = 0;
            code = touch_next(decoder, &m_arena[n % c_slots], &m_frame[n % c_slots]);
            if (code == TOUCH_OK) m_newest = n++;
        }
        if (code != TOUCH_END) {
            m_isOver = true;  // a file that contradicts itself: the force ends
            return;
        }
    }
}

double cTouchfieldEffect::frameNow() const {
    double seconds = m_time;
    if (seconds < 0.0) {
        const auto now = m_isStarted ? std::chrono::steady_clock::now() : m_start;
        seconds = std::chrono::duration<double>(now - m_start).count();
    }
    return std::min(seconds * m_file.rate_hz, static_cast<double>(m_file.frame_count) - 1.0);
}

bool cTouchfieldEffect::computeForce(const chai3d::cVector3d& a_toolPos, const chai3d::cVector3d&,
                                     const unsigned int&, chai3d::cVector3d& a_reactionForce) {
    a_reactionForce.zero();
    const std::int64_t newest = m_newest;
    if (newest < 0 || m_isOver) return false;
    if (!m_isStarted) {
        m_start = std::chrono::steady_clock::now();
        m_isStarted = true;
    }
    const double frame = std::min(frameNow(), static_cast<double>(newest));
    const auto a = std::max(static_cast<std::int64_t>(frame), m_oldest.load());
    m_oldest = a;
    const double at[3] = {a_toolPos.x(), a_toolPos.y(), a_toolPos.z()};
    double newtons[3];
    touch_force_between(&m_frame[a % c_slots], &m_frame[std::min(a + 1, newest) % c_slots],
                        frame - static_cast<double>(a), at, std::min(m_most.load(), m_file.force_max_n), newtons);
    a_reactionForce.set(newtons[0], newtons[1], newtons[2]);
    return newtons[0] != 0.0 || newtons[1] != 0.0 || newtons[2] != 0.0;
}
