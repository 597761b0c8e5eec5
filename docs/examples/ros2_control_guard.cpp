// A ros2_control controller for one joint: a spring and a damper whose gains come from parameters
// or from a topic, and pass a guard before they reach the motor. Its walls are proved for every
// sequence of delays, but not for gains or a mass that change while the spring acts; so the guard is
// called once, at activation, and new gains take effect at the next one. Made beforehand:
//
//     jaxstab guard joint.toml -o joint_guard.h
//
// Interfaces: position and velocity in, effort out.
#include <controller_interface/controller_interface.hpp>

#include "joint_guard.h"

namespace guarded {

class ImpedanceController : public controller_interface::ControllerInterface {
public:
    controller_interface::InterfaceConfiguration command_interface_configuration() const override
    {
        return {controller_interface::interface_configuration_type::INDIVIDUAL, {"joint/effort"}};
    }

    controller_interface::InterfaceConfiguration state_interface_configuration() const override
    {
        return {controller_interface::interface_configuration_type::INDIVIDUAL,
                {"joint/position", "joint/velocity"}};
    }

    controller_interface::CallbackReturn on_activate(const rclcpp_lifecycle::State& state) override
    {
        (void)state;
        stiffness_ = wanted_stiffness_;
        damping_ = wanted_damping_;
        const bool is_refused
            = joint_guard_clamp(&stiffness_, &damping_, inertia_) == JOINT_GUARD_REFUSED;
        return is_refused ? controller_interface::CallbackReturn::FAILURE
                          : controller_interface::CallbackReturn::SUCCESS;
    }

    // Real-time safe: no allocation, no lock, no exception.
    controller_interface::return_type update(
        const rclcpp::Time& time, const rclcpp::Duration& period) override
    {
        (void)time;
        (void)period;
        const double position = state_interfaces_[0].get_value();
        const double velocity = state_interfaces_[1].get_value();
        command_interfaces_[0].set_value(-stiffness_ * (position - rest_) - damping_ * velocity);
        return controller_interface::return_type::OK;
    }

private:
    double wanted_stiffness_ = 100.0, wanted_damping_ = 2.0, rest_ = 0.0;
    double inertia_ = 0.04;  // kg m^2 at the joint, in this posture
    double stiffness_ = 0.0, damping_ = 0.0;  // granted, from activation on
};

}  // namespace guarded

controller_interface::return_type turn(
    guarded::ImpedanceController& controller, const rclcpp::Time& time)
{
    return controller.update(time, rclcpp::Duration());
}
