// A stand-in for the base of chainable controllers: the calls that a controller manager makes, in their order.
#ifndef STAND_IN_CHAINABLE
#define STAND_IN_CHAINABLE

#include <string>
#include <vector>

#include "hardware_interface/loaned_interfaces.hpp"
#include "rclcpp_lifecycle/lifecycle_node.hpp"

namespace controller_interface
{
using CallbackReturn = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;
enum class return_type : std::uint8_t { OK = 0, ERROR = 1 };
enum class interface_configuration_type : std::uint8_t { ALL = 0, INDIVIDUAL = 1, NONE = 2 };

struct InterfaceConfiguration
{
  interface_configuration_type type = interface_configuration_type::NONE;
  std::vector<std::string> names = {};
};

struct ControllerInterfaceParams
{
  std::string controller_name, robot_description, node_namespace;
  unsigned int update_rate = 0, controller_manager_update_rate = 0;
  rclcpp::NodeOptions node_options;
};

class ChainableControllerInterface : public rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface
{
public:
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual CallbackReturn on_init() = 0;

  return_type init(const ControllerInterfaceParams & told)
  {
    node_ = std::make_shared<rclcpp_lifecycle::LifecycleNode>(told.controller_name, "", told.node_options, false);
    rate_ = told.update_rate;
    node_->register_on_configure([this](const auto & before) { return on_configure(before); });
    node_->register_on_activate([this](const auto & before) { return on_activate(before); });
    node_->register_on_deactivate([this](const auto & before) { return on_deactivate(before); });
    return on_init() == CallbackReturn::SUCCESS ? return_type::OK : return_type::ERROR;
  }
  const rclcpp_lifecycle::State & configure() { return node_->configure(); }
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() const { return node_; }
  unsigned int get_update_rate() const { return rate_; }

  void assign_interfaces(
    std::vector<hardware_interface::LoanedCommandInterface> && commands,
    std::vector<hardware_interface::LoanedStateInterface> && states)
  {
    command_interfaces_ = std::move(commands);
    state_interfaces_ = std::move(states);
  }
  std::vector<hardware_interface::CommandInterface::SharedPtr> export_reference_interfaces()
  {
    return on_export_reference_interfaces_list();
  }
  bool set_chained_mode(bool chained)
  {
    chained_ = on_set_chained_mode(chained) && chained;
    return true;
  }
  return_type update(const rclcpp::Time & time, const rclcpp::Duration & period)
  {
    const auto taken = chained_ ? return_type::OK : update_reference_from_subscribers(time, period);
    return taken == return_type::OK ? update_and_write_commands(time, period) : taken;
  }

protected:
  virtual std::vector<hardware_interface::CommandInterface::SharedPtr> on_export_reference_interfaces_list() = 0;
  virtual bool on_set_chained_mode(bool) { return true; }
  virtual return_type update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &) = 0;
  virtual return_type update_and_write_commands(const rclcpp::Time &, const rclcpp::Duration &) = 0;
  template <typename T>
  T auto_declare(const std::string & name, const T & value)
  {
    return node_->declare_parameter<T>(name, value);
  }

  std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
  std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;

private:
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_;
  unsigned int rate_ = 0;
  bool chained_ = false;
};
}  // namespace controller_interface

#endif
