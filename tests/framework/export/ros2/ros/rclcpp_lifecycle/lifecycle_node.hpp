// A stand-in for a node with a life cycle: its parameters, and calls at its transitions.
#ifndef STAND_IN_LIFECYCLE_NODE
#define STAND_IN_LIFECYCLE_NODE

#include <functional>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>

#include "lifecycle_msgs/msg/state.hpp"
#include "rclcpp/rclcpp.hpp"

namespace rclcpp_lifecycle
{
class State
{
public:
  explicit State(std::uint8_t id = 1) : id_(id) {}
  std::uint8_t id() const { return id_; }
  std::string label() const { return std::to_string(id_); }

private:
  std::uint8_t id_;
};

namespace node_interfaces
{
class LifecycleNodeInterface
{
public:
  enum class CallbackReturn : std::uint8_t { SUCCESS = 97, FAILURE = 98, ERROR = 99 };
  virtual ~LifecycleNodeInterface() = default;
  virtual CallbackReturn on_configure(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_cleanup(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_shutdown(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_activate(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_deactivate(const State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_error(const State &) { return CallbackReturn::SUCCESS; }
};
}  // namespace node_interfaces

class LifecycleNode
{
public:
  using Return = node_interfaces::LifecycleNodeInterface::CallbackReturn;
  using Call = std::function<Return(const State &)>;

  LifecycleNode(const std::string & name, const std::string &, const rclcpp::NodeOptions &, bool) : name_(name) {}
  const char * get_name() const { return name_.c_str(); }
  rclcpp::Logger get_logger() const { return {name_}; }
  std::shared_ptr<rclcpp::Clock> get_clock() { return std::make_shared<rclcpp::Clock>(); }

  bool has_parameter(const std::string & name) const { return parameters_.count(name) != 0; }
  template <typename T>
  T declare_parameter(const std::string & name, const T & value)
  {
    return parameters_.emplace(name, rclcpp::Parameter(rclcpp::Parameter::Value(value))).first->second.template get_value<T>();
  }
  rclcpp::Parameter get_parameter(const std::string & name) const
  {
    const auto found = parameters_.find(name);
    if (found == parameters_.end()) throw std::runtime_error("no parameter " + name);
    return found->second;
  }
  void set_parameter(const std::string & name, rclcpp::Parameter::Value value)
  {
    parameters_.insert_or_assign(name, rclcpp::Parameter(std::move(value)));
  }

  void register_on_configure(Call call) { configure_ = std::move(call); }
  void register_on_cleanup(Call) {}
  void register_on_activate(Call call) { activate_ = std::move(call); }
  void register_on_deactivate(Call call) { deactivate_ = std::move(call); }
  void register_on_shutdown(Call) {}
  void register_on_error(Call) {}

  const State & get_current_state() const { return state_; }
  const State & configure() { return moved(configure_, 2); }
  const State & activate() { return moved(activate_, 3); }
  const State & deactivate() { return moved(deactivate_, 2); }
  const State & shutdown() { return state_ = State(4); }

private:
  const State & moved(const Call & call, std::uint8_t to)
  {
    if (call(state_) == Return::SUCCESS) state_ = State(to);
    return state_;
  }

  std::string name_;
  State state_;
  std::map<std::string, rclcpp::Parameter> parameters_;
  Call configure_, activate_, deactivate_;
};
}  // namespace rclcpp_lifecycle

#endif
