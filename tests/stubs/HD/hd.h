// The few declarations of OpenHaptics that docs/examples/openhaptics_guard.cpp uses.
#pragma once
#define HDCALLBACK
#define HD_CURRENT_POSITION 0x2050
#define HD_CURRENT_FORCE 0x2700
#define HD_CALLBACK_CONTINUE 1
typedef unsigned int HDCallbackCode, HHD, HDenum;
typedef double HDdouble;
inline HHD hdGetCurrentDevice() { return 0; }
inline void hdBeginFrame(HHD) {}
inline void hdEndFrame(HHD) {}
inline void hdGetDoublev(HDenum, HDdouble*) {}
inline void hdSetDoublev(HDenum, const HDdouble*) {}
