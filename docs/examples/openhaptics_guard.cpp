// A clamp in the servo loop of OpenHaptics (HDAPI). The header is made beforehand, for your device:
//
//     jaxstab guard touch.toml -o touch_guard.h
//
// OpenHaptics does not say how it smooths HD_CURRENT_VELOCITY, so the velocity is computed here: the
// difference over 8 ticks, as in the scene. Positions are in mm there and in m here. Gains have to be
// constant while the wall is touched, so the guard is called once, when contact begins.
#include <HD/hd.h>

#include "touch_guard.h"

struct Wall {                         // a floor at y = 0
    double stiffness, damping;        // wanted, N/m and N s/m; may change at any time
    double held_stiffness, held_damping;  // of this contact
    double heights[9];                // m, of the last 8 ticks and this one
    int ticks;
    bool is_touched;
};

HDCallbackCode HDCALLBACK render(void* data)
{
    const double mass = 0.05;  // kg, at this posture
    const double period = 1e-3;  // s
    Wall& wall = *static_cast<Wall*>(data);

    hdBeginFrame(hdGetCurrentDevice());
    HDdouble position[3];
    hdGetDoublev(HD_CURRENT_POSITION, position);
    for (int i = 0; i < 8; ++i)
        wall.heights[i] = wall.heights[i + 1];
    wall.heights[8] = 1e-3 * position[1];
    if (wall.ticks < 9)
        ++wall.ticks;

    HDdouble force[3] = {0.0, 0.0, 0.0};
    const bool is_inside = wall.ticks == 9 && wall.heights[8] < 0.0;
    if (is_inside) {
        if (!wall.is_touched) {
            wall.held_stiffness = wall.stiffness;
            wall.held_damping = wall.damping;
            // 0 and 0 where nothing is proved.
            touch_guard_clamp(&wall.held_stiffness, &wall.held_damping, mass);
        }
        const double velocity = (wall.heights[8] - wall.heights[0]) / (8 * period);
        force[1] = -wall.held_stiffness * wall.heights[8] - wall.held_damping * velocity;
    }
    wall.is_touched = is_inside;
    hdSetDoublev(HD_CURRENT_FORCE, force);
    hdEndFrame(hdGetCurrentDevice());
    return HD_CALLBACK_CONTINUE;
}
