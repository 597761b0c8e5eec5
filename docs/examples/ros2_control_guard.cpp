// A ros2_control controller for one joint: a spring and a damper whose gains come from parameters
// or from a topic, and pass a guard before they reach the motor. The header is made beforehand:
//
//     jaxstab guard wheel.toml -o omega_guard.h
//
// Interfaces: position and velocity in, effort out.
#include <controller_interface/controller_interface.hpp>

#include "omega_guard.h"

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

    controller_interface::return_type update(
        const rclcpp::Time& time, const rclcpp::Duration& period) override
    {
        (void)time;
        const double position = state_interfaces_[0].get_value();
        const double velocity = state_interfaces_[1].get_value();
        // Real-time safe: no allocation, no lock, no exception, less than a microsecond.
        double stiffness = stiffness_, damping = damping_;
        const double delay = delay_samples_ * period.seconds();
        refused_ = omega_guard_clamp(&stiffness, &damping, mass_, delay) == OMEGA_GUARD_REFUSED;
        command_interfaces_[0].set_value(-stiffness * (position - rest_) - damping * velocity);
        return refused_ ? controller_interface::return_type::ERROR
                        : controller_interface::return_type::OK;
    }

private:
    double stiffness_ = 500.0, damping_ = 5.0, rest_ = 0.0;
    double mass_ = 0.25;          // what the joint moves, from the posture
    double delay_samples_ = 1.0;  // measured
    bool refused_ = false;
};

}  // namespace guarded

controller_interface::return_type turn(
    guarded::ImpedanceController& controller, const rclcpp::Time& time)
{
    return controller.update(time, rclcpp::Duration());
}
