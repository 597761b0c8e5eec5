// A clamp in CHAI3D's haptic thread. The header is made beforehand, for your device and loop:
//
//     jaxstab guard omega.toml -o omega_guard.h
//
// CHAI3D 3.3 has a largest stiffness and damping of each device (cHapticDeviceInfo), the same for
// all hands, postures and rates, and does not clamp to them. Here the maker's limits come first,
// then those that are proved.
#include <chrono>

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
        const auto begin = std::chrono::steady_clock::now();
        cVector3d position, velocity;
        device_->getPosition(position);
        device_->getLinearVelocity(velocity);

        stiffness = stiffness < most_stiffness_ ? stiffness : most_stiffness_;
        damping = damping < most_damping_ ? damping : most_damping_;
        // REFUSED: the mass or the delay is out of the ranges that were proved; both gains are 0.
        const int code = omega_guard_clamp(&stiffness, &damping, mass, delay_);

        const bool inside = position.z() < 0.0;
        const double force = inside ? -stiffness * position.z() - damping * velocity.z() : 0.0;
        device_->setForce(cVector3d(0.0, 0.0, force));

        // The delay from reading to writing, and what the transport adds (here one period).
        const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - begin;
        const double delay = taken.count() + transport_;
        delay_ += 0.01 * (delay - delay_);
        return code;
    }

private:
    cGenericHapticDevicePtr device_;
    double most_stiffness_, most_damping_;
    double transport_ = 0.001;  // s
    double delay_ = 0.001;      // s, smoothed
};

int renderOnce(cGenericHapticDevicePtr device)
{
    static GuardedWall wall(device);
    return wall.render(5000.0, 30.0, 0.25);
}
