// Options of the programs of this folder: those of cTouchfieldSettings.
#pragma once
#include "cTouchfieldEffect.h"

#include <cstdlib>
#include <cstring>

// Reads the options; the name of the file, or nullptr: see the usage.
static inline const char* readOptions(int a_count, char** a_words, cTouchfieldSettings& a_settings, bool& a_isRealTime) {
    int n = 1;
    for (; n + 1 < a_count; n++) {
        if (!std::strcmp(a_words[n], "-l")) a_settings.m_loop = true;
        else if (!std::strcmp(a_words[n], "-r")) a_isRealTime = true;
        else if (!std::strcmp(a_words[n], "-p")) a_settings.m_forceMax = std::atof(a_words[++n]);
        else if (!std::strcmp(a_words[n], "-m")) a_settings.m_friction = std::atof(a_words[++n]);
        else if (!std::strcmp(a_words[n], "-d")) a_settings.m_damping = std::atof(a_words[++n]);
        else if (!std::strcmp(a_words[n], "-c")) a_settings.m_coupling = std::atof(a_words[++n]);
        else if (!std::strcmp(a_words[n], "-k")) a_settings.m_wallStiffness = std::atof(a_words[++n]);
        else return nullptr;
    }
    return n + 1 == a_count ? a_words[n] : nullptr;
}
