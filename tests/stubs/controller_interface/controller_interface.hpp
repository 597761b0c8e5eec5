// The few declarations of ros2_control that docs/examples/ros2_control_guard.cpp uses.
#pragma once
#include <string>
#include <vector>
namespace rclcpp {
class Time {};
class Duration {
public:
    double seconds() const { return 0.001; }
};
}  // namespace rclcpp
namespace rclcpp_lifecycle {
class State {};
}  // namespace rclcpp_lifecycle
namespace controller_interface {
enum class return_type { OK, ERROR };
enum class CallbackReturn { SUCCESS, FAILURE };
enum class interface_configuration_type { INDIVIDUAL };
struct InterfaceConfiguration {
    interface_configuration_type type;
    std::vector<std::string> names;
};
struct Interface {
    double value;
    double get_value() const { return value; }
    void set_value(double given) { value = given; }
};
class ControllerInterface {
public:
    virtual ~ControllerInterface() {}
    virtual InterfaceConfiguration command_interface_configuration() const = 0;
    virtual InterfaceConfiguration state_interface_configuration() const = 0;
    virtual CallbackReturn on_activate(const rclcpp_lifecycle::State&) = 0;
    virtual return_type update(const rclcpp::Time&, const rclcpp::Duration&) = 0;

protected:
    std::vector<Interface> state_interfaces_, command_interfaces_;
};
}  // namespace controller_interface
