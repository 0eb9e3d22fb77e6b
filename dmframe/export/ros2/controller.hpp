// DM_ABOUT
#ifndef DM_GUARD
#define DM_GUARD

#include <string>
#include <vector>

#include "controller_interface/chainable_controller_interface.hpp"

#include "DM_FILE.h"

namespace DM_PACKAGE
{

/// DM_FILE under a controller manager: an update is one sample, without memory allocation or logging.
class Controller : public controller_interface::ChainableControllerInterface
{
public:
  controller_interface::InterfaceConfiguration command_interface_configuration() const override;
  controller_interface::InterfaceConfiguration state_interface_configuration() const override;
  controller_interface::CallbackReturn on_init() override;
  controller_interface::CallbackReturn on_configure(const rclcpp_lifecycle::State & before) override;
  controller_interface::CallbackReturn on_activate(const rclcpp_lifecycle::State & before) override;
  controller_interface::CallbackReturn on_deactivate(const rclcpp_lifecycle::State & before) override;

protected:
  std::vector<hardware_interface::CommandInterface::SharedPtr> on_export_reference_interfaces_list() override;
  controller_interface::return_type update_reference_from_subscribers(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;
  controller_interface::return_type update_and_write_commands(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;

private:
  static constexpr std::size_t n = DM_JOINTS;

  const char * pass(double lasted);
  const char * on_path(double t, double T);
  bool use_own_path();
  void measure(double scale);
  const char * read(std::size_t first, double * values) const;
  bool command(double fraction);

  DM_FILE_controller law_{};
  DM_FILE_parameters parameters_{};
  DM_FILE_measured measured_{};
  DM_FILE_commanded commanded_{};
  std::vector<std::string> joints_;
  std::string position_, velocity_, target_, scaling_, command_;
  hardware_interface::CommandInterface::SharedPtr pace_;
  std::vector<hardware_interface::CommandInterface::SharedPtr> path_references_;
  DM_FILE_path path_{};
  long patience_ = 5;
  const char * fault_ = "";
  bool begun_ = false;
  long samples_ = 0;
  double behind_ = 0, scale_ = 0, fraction_ = 0;
  double q_[n] = {}, dq_[n] = {}, q_c_[n] = {}, sent_[n] = {};
};

}  // namespace DM_PACKAGE

#endif
