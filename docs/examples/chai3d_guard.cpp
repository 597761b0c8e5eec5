// A clamp in CHAI3D's haptic thread. The header is made beforehand, for your device and loop:
//
//     jaxstab guard omega.toml -o omega_guard.h
//
// CHAI3D 3.3 has a largest stiffness and damping of each device (cHapticDeviceInfo), the same for
// all hands, postures and rates, and does not clamp to them. Here the maker's limits come first,
// then those that are proved, for every sequence of delays. Gains and mass have to be constant while
// the wall is touched, so the guard is called once, when contact begins, and its gains are held.
#include "chai3d.h"
#include "omega_guard.h"

using namespace chai3d;

// What the hand meets: a horizontal wall at z = 0, of a stiffness and a damping that were wished.
class GuardedWall {
public:
    explicit GuardedWall(cGenericHapticDevicePtr device) : device_(device)
    {
        const cHapticDeviceInfo info = device->getSpecifications();
        most_stiffness_ = info.m_maxLinearStiffness;
        most_damping_ = info.m_maxLinearDamping;
    }

    // One turn of the haptic loop. `mass` is the device's at this posture, in kg.
    int render(double stiffness, double damping, double mass)
    {
        cVector3d position, velocity;
        device_->getPosition(position);
        device_->getLinearVelocity(velocity);

        const bool inside = position.z() < 0.0;
        if (inside && !touching_) {
            stiffness_ = stiffness < most_stiffness_ ? stiffness : most_stiffness_;
            damping_ = damping < most_damping_ ? damping : most_damping_;
            // REFUSED: the mass is out of the proved range; both gains are 0.
            code_ = omega_guard_clamp(&stiffness_, &damping_, mass);
        }
        touching_ = inside;
        const double force = inside ? -stiffness_ * position.z() - damping_ * velocity.z() : 0.0;
        device_->setForce(cVector3d(0.0, 0.0, force));
        return code_;
    }

private:
    cGenericHapticDevicePtr device_;
    double most_stiffness_, most_damping_;
    double stiffness_ = 0.0, damping_ = 0.0;  // of this contact
    bool touching_ = false;
    int code_ = OMEGA_GUARD_UNCHANGED;
};

int renderOnce(cGenericHapticDevicePtr device)
{
    static GuardedWall wall(device);
    return wall.render(5000.0, 30.0, 0.25);
}
