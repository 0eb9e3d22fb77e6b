// DM_ABOUT
#include "DM_PACKAGE/controller.hpp"

#include <array>
#include <cmath>
#include <cstring>
#include <memory>

#include "pluginlib/class_list_macros.hpp"
#include "rclcpp/logging.hpp"

namespace DM_PACKAGE
{
namespace
{
using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::interface_configuration_type;
using controller_interface::return_type;

constexpr double PERIOD = DM_PERIOD;  // s
constexpr double STILL = 0.01;  // pace below which the controller waits
constexpr bool NEEDS_TARGET = DM_NEEDS_TARGET;  // the law reads the servo's target

struct Row
{
  const char * name;
  std::size_t first, size;
};

/// Parameters, and their indices in DM_FILE_parameters.
constexpr std::array<Row, DM_COUNT> ROWS = {{
DM_ROWS
}};

struct Part
{
  const char * name;
  std::size_t size;
};

/// Parts of the path, in the order of DM_FILE_path.
constexpr std::array<Part, DM_PARTS> PATH = {{
DM_PATH
}};
}  // namespace

CallbackReturn Controller::on_init()
{
  try {
    auto_declare<std::vector<std::string>>("joints", {DM_NAMES});
    auto_declare<std::string>("interfaces.position", "position");
    auto_declare<std::string>("interfaces.velocity", "velocity");
    auto_declare<std::string>("interfaces.target", "");
    auto_declare<std::string>("interfaces.scaling", "");
    auto_declare<std::string>("interfaces.command", "velocity");
    auto_declare<int>("patience", 5);
    const double * value = reinterpret_cast<const double *>(&DM_FILE_defaults);
    for (const Row & row : ROWS) {
      const double * first = value + row.first;
      auto_declare<std::vector<double>>(row.name, std::vector<double>(first, first + row.size));
    }
  } catch (const std::exception & error) {
    RCLCPP_ERROR(get_node()->get_logger(), "parameters: %s", error.what());
    return CallbackReturn::ERROR;
  }
  return CallbackReturn::SUCCESS;
}

CallbackReturn Controller::on_configure(const rclcpp_lifecycle::State &)
{
  const auto logger = get_node()->get_logger();
  const auto word = [this](const char * name) { return get_node()->get_parameter(name).as_string(); };
  joints_ = get_node()->get_parameter("joints").as_string_array();
  if (joints_.size() != n) {
    RCLCPP_ERROR(logger, "joints: expected %zu names, found %zu", n, joints_.size());
    return CallbackReturn::FAILURE;
  }
  position_ = word("interfaces.position");
  velocity_ = word("interfaces.velocity");
  target_ = word("interfaces.target");
  scaling_ = word("interfaces.scaling");
  command_ = word("interfaces.command");
  patience_ = get_node()->get_parameter("patience").as_int();
  if (patience_ < 1 || patience_ > 1000) {
    RCLCPP_ERROR(logger, "patience: expected 1 to 1000 periods, found %ld", patience_);
    return CallbackReturn::FAILURE;
  }
  const double rate = get_update_rate();
  if (rate > 0 && std::fabs(rate * PERIOD - 1) > 1e-3) {
    RCLCPP_ERROR(logger, "update_rate: expected %g Hz, the clock of the law, found %g Hz", 1 / PERIOD, rate);
    return CallbackReturn::FAILURE;
  }
  parameters_ = DM_FILE_defaults;
  for (const Row & row : ROWS) {
    const auto given = get_node()->get_parameter(row.name).as_double_array();
    if (given.size() != row.size) {
      RCLCPP_ERROR(logger, "%s: expected %zu numbers, found %zu", row.name, row.size, given.size());
      return CallbackReturn::FAILURE;
    }
    double * value = reinterpret_cast<double *>(&parameters_) + row.first;
    for (const double number : given) {
      if (!std::isfinite(number)) {
        RCLCPP_ERROR(logger, "%s: expected finite numbers", row.name);
        return CallbackReturn::FAILURE;
      }
      *value++ = number;
    }
  }
  DM_FILE_init(&law_, &parameters_);
  return CallbackReturn::SUCCESS;
}

InterfaceConfiguration Controller::command_interface_configuration() const
{
  InterfaceConfiguration wanted{interface_configuration_type::INDIVIDUAL, {}};
  for (const auto & joint : joints_) wanted.names.push_back(joint + "/" + command_);
  return wanted;
}

InterfaceConfiguration Controller::state_interface_configuration() const
{
  InterfaceConfiguration wanted{interface_configuration_type::INDIVIDUAL, {}};
  for (const auto * kind : {&position_, &velocity_, &target_}) {
    if (kind == &target_ && target_.empty()) continue;
    for (const auto & joint : joints_) wanted.names.push_back(joint + "/" + *kind);
  }
  if (!scaling_.empty()) wanted.names.push_back(scaling_);
  return wanted;
}

std::vector<hardware_interface::CommandInterface::SharedPtr> Controller::on_export_reference_interfaces_list()
{
  const auto made = [this](const std::string & name) {
    hardware_interface::InterfaceInfo info;
    info.name = name;
    info.data_type = "double";
    return std::make_shared<hardware_interface::CommandInterface>(
      hardware_interface::InterfaceDescription(get_node()->get_name(), info));
  };
  pace_ = made("pace");
  path_references_.clear();
  for (const Part & part : PATH) {
    for (std::size_t k = 0; k < part.size; k++) path_references_.push_back(made(std::string(part.name) + "." + std::to_string(k)));
  }
  std::vector<hardware_interface::CommandInterface::SharedPtr> all{pace_};
  all.insert(all.end(), path_references_.begin(), path_references_.end());
  return all;
}

CallbackReturn Controller::on_activate(const rclcpp_lifecycle::State &)
{
  const std::size_t states = (target_.empty() ? 2 : 3) * n + (scaling_.empty() ? 0 : 1);
  if (command_interfaces_.size() != n || state_interfaces_.size() != states) {
    RCLCPP_ERROR(get_node()->get_logger(), "expected %zu command and %zu state interfaces", n, states);
    return CallbackReturn::FAILURE;
  }
  if (NEEDS_TARGET && target_.empty()) {
    RCLCPP_WARN(
      get_node()->get_logger(),
      "interfaces.target is empty: the target is the measured start plus the integral of the commands");
  }
  begun_ = false;
  fault_ = "";
  const bool set = pace_ == nullptr || use_own_path();
  return command(0) && set ? CallbackReturn::SUCCESS : CallbackReturn::FAILURE;
}

CallbackReturn Controller::on_deactivate(const rclcpp_lifecycle::State &)
{
  if (*fault_ != 0) RCLCPP_ERROR(get_node()->get_logger(), "stopped: %s", fault_);
  return command(0) ? CallbackReturn::SUCCESS : CallbackReturn::ERROR;
}

/// Select the graph's path and pace; a preceding controller may set others.
bool Controller::use_own_path()
{
  bool set = pace_->set_value(1.0);
  for (const auto & one : path_references_) set = one->set_value(static_cast<double>(NAN)) && set;
  return set;
}

return_type Controller::update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &)
{
  if (!use_own_path() && *fault_ == 0) fault_ = "the pace could not be set";
  return return_type::OK;  // zeros are commanded after a fault
}

return_type Controller::update_and_write_commands(const rclcpp::Time &, const rclcpp::Duration & period)
{
  if (*fault_ == 0) fault_ = pass(period.seconds());
  const bool sent = command(*fault_ == 0 ? fraction_ : 0);
  if (!sent && *fault_ == 0) fault_ = "a command could not be set";
  return *fault_ == 0 ? return_type::OK : return_type::ERROR;
}

/// Compute one sample, `lasted` s after the last; returns a fault.
const char * Controller::pass(double lasted)
{
  const auto pace = pace_->get_optional();
  double scaling = 1;
  const char * fault = read(0, q_);
  if (*fault == 0) fault = read(n, dq_);
  if (*fault == 0 && !target_.empty()) fault = read(2 * n, q_c_);
  if (*fault != 0) return fault;
  if (!scaling_.empty()) {
    const auto found = state_interfaces_.back().get_optional();
    scaling = found ? *found : NAN;
  }
  if (!pace || !(*pace >= 0 && *pace <= 1)) return "pace: expected a number from 0 to 1";
  if (!(scaling >= 0 && scaling <= 1)) return "interfaces.scaling: expected a number from 0 to 1";

  long periods = 1;
  if (begun_) {
    if (!(lasted >= 0 && lasted < (static_cast<double>(patience_) + 0.5) * PERIOD)) return "samples were lost";
    periods = std::lround(lasted / PERIOD);
    if (periods < 1) periods = 1;
    samples_ += periods;
    behind_ += (1 - scale_) * (static_cast<double>(periods) * PERIOD);
    if (target_.empty()) {
      for (std::size_t k = 0; k < n; k++) q_c_[k] += static_cast<double>(periods) * PERIOD * sent_[k];
    }
  } else {
    samples_ = 0;
    behind_ = 0;
    if (target_.empty()) std::memcpy(q_c_, q_, sizeof q_c_);
  }

  const double scale = *pace * scaling;
  const double t = static_cast<double>(samples_) * PERIOD - behind_;
  scale_ = scale >= STILL ? scale : 0;
  fraction_ = scale >= STILL ? *pace : 0;
  if (!begun_) {
    measure(1);
    if (!DM_FILE_reset(&law_, &measured_, t)) return "it cannot start from the measurements";
  }
  if (scale >= STILL) {
    measure(scale);
    const double T = scale * (PERIOD * static_cast<double>(periods));
    fault = on_path(t, T);
    if (*fault != 0) return fault;
    if (!DM_FILE_step_on(&law_, &measured_, &path_, t, T, &commanded_)) {
      return "a command or a state is not finite";
    }
  }
  begun_ = true;
  for (std::size_t k = 0; k < n; k++) sent_[k] = fraction_ * scaling * commanded_.DM_COMMAND[k];
  return "";
}

/// Path of a preceding controller, or the graph's.
const char * Controller::on_path(double t, double T)
{
  DM_FILE_path_at(&law_, t, T, &path_);
  double * number = reinterpret_cast<double *>(&path_);
  std::size_t given = 0;
  for (const auto & one : path_references_) {
    const auto value = one->get_optional();
    if (!value) return "the path could not be read";
    if (std::isnan(*value)) continue;
    given++;
    number[&one - path_references_.data()] = *value;
  }
  return given == 0 || given == path_references_.size() ? "" : "path: expected all of its numbers, or none";
}

/// Measurements in the law's time, which runs `scale` times as fast as the robot's.
void Controller::measure(double scale)
{
DM_MEASURED
}

/// Read `n` state interfaces from `first` on.
const char * Controller::read(std::size_t first, double * values) const
{
  for (std::size_t k = 0; k < n; k++) {
    const auto value = state_interfaces_[first + k].get_optional();
    if (!value) return "a state interface could not be read";
    if (!std::isfinite(*value)) return "a state interface is not finite";
    values[k] = *value;
  }
  return "";
}

/// Write a fraction of the law's commands, or zeros.
bool Controller::command(double fraction)
{
  bool set = true;
  for (std::size_t k = 0; k < n; k++) {
    set = command_interfaces_[k].set_value(fraction == 0 ? 0.0 : fraction * commanded_.DM_COMMAND[k]) && set;
  }
  return set;
}

}  // namespace DM_PACKAGE

PLUGINLIB_EXPORT_CLASS(DM_PACKAGE::Controller, controller_interface::ChainableControllerInterface)
