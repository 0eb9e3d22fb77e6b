// A controller manager in small: it loads the controller, and hands it rows of numbers from the standard input.
//
// Words of the command line: RATE COLUMNS, then NAME=VALUE for parameters that are words. A row holds the period [s], the
// pace (negative: not chained), the other references, and the state interfaces in the order of the configuration. For each
// row it prints the result, how much memory the update asked for, and the commands.
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <map>

#include "controller_interface/chainable_controller_interface.hpp"

extern "C" void * __libc_malloc(std::size_t);
static unsigned long asked = 0;
extern "C" void * malloc(std::size_t size)
{
  asked++;
  return __libc_malloc(size);
}

std::shared_ptr<controller_interface::ChainableControllerInterface> created_controller();

int main(int count, char ** words)
{
  using controller_interface::return_type;
  auto controller = created_controller();
  controller_interface::ControllerInterfaceParams told;
  told.controller_name = "law";
  told.update_rate = told.controller_manager_update_rate = static_cast<unsigned int>(std::atoi(words[1]));
  if (controller->init(told) != return_type::OK) return 2;
  auto node = controller->get_node();
  for (int k = 2; k < count; k++) {
    const std::string word = words[k], name = word.substr(0, word.find('=')), value = word.substr(word.find('=') + 1);
    if (name == "joints") {
      node->set_parameter(name, std::vector<std::string>{value});
    } else if (name.rfind("interfaces.", 0) == 0) {
      node->set_parameter(name, value);
    } else {
      node->set_parameter(name, std::vector<double>{std::atof(value.c_str())});
    }
  }
  if (controller->configure().id() != 2) return 3;
  const auto references = controller->export_reference_interfaces();
  for (const auto & one : references) std::cout << one->get_name() << ' ';
  std::cout << '\n';

  const auto made = [](const std::string & full) {
    const auto at = full.rfind('/');
    hardware_interface::InterfaceInfo info;
    info.name = full.substr(at + 1);
    info.data_type = "double";
    return std::make_shared<hardware_interface::CommandInterface>(
      hardware_interface::InterfaceDescription(full.substr(0, at), info));
  };
  std::vector<std::shared_ptr<hardware_interface::CommandInterface>> commands;
  std::vector<std::shared_ptr<hardware_interface::StateInterface>> states;
  std::vector<hardware_interface::LoanedCommandInterface> lent_commands;
  std::vector<hardware_interface::LoanedStateInterface> lent_states;
  for (const auto & name : controller->command_interface_configuration().names) commands.push_back(made(name));
  for (const auto & name : controller->state_interface_configuration().names) {
    const auto at = name.rfind('/');
    hardware_interface::InterfaceInfo info;
    info.name = name.substr(at + 1);
    info.data_type = "double";
    states.push_back(std::make_shared<hardware_interface::StateInterface>(
      hardware_interface::InterfaceDescription(name.substr(0, at), info)));
    std::cout << name << '\n';
  }
  for (const auto & one : commands) lent_commands.emplace_back(one, nullptr);
  for (const auto & one : states) lent_states.emplace_back(one, nullptr);
  controller->assign_interfaces(std::move(lent_commands), std::move(lent_states));
  if (node->activate().id() != 3) return 4;

  std::int64_t now = 0;
  double period, pace, value;
  bool chained = false;
  while (std::scanf("%lf %lf", &period, &pace) == 2) {
    std::vector<double> path;
    for (std::size_t k = 1; k < references.size(); k++) {
      if (std::scanf("%lf", &value) != 1) return 5;
      path.push_back(value);
    }
    for (const auto & one : states) {
      if (std::scanf("%lf", &value) != 1) return 5;
      if (!one->set_value(value)) return 6;
    }
    if ((pace >= 0 || pace != pace) && !chained) {  // an arm that is not active may be chained
      node->deactivate();
      chained = controller->set_chained_mode(true);
      node->activate();
    }
    if (chained && !references[0]->set_value(pace)) return 7;
    for (std::size_t k = 1; chained && k < references.size(); k++) {
      if (!references[k]->set_value(path[k - 1])) return 7;
    }
    const auto length = std::chrono::nanoseconds(static_cast<std::int64_t>(period * 1e9 + 0.5));
    now += length.count();
    const unsigned long before = asked;
    const auto found = controller->update(rclcpp::Time(now), rclcpp::Duration(length));
    std::printf("%d %lu", static_cast<int>(found), asked - before);
    for (const auto & one : commands) std::printf(" %a", *one->get_optional());
    std::printf("\n");
  }
  std::fflush(stdout);
  node->deactivate();
  std::printf("last");
  for (const auto & one : commands) std::printf(" %a", *one->get_optional());
  std::printf("\n");
  return 0;
}
