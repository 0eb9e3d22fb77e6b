// A stand-in for the interfaces that a controller manager lends, with the signatures that a controller uses.
#ifndef STAND_IN_LOANED_INTERFACES
#define STAND_IN_LOANED_INTERFACES

#include <functional>
#include <memory>
#include <optional>
#include <string>

namespace hardware_interface
{
struct InterfaceInfo
{
  std::string name, min, max, initial_value, data_type;
};

struct InterfaceDescription
{
  InterfaceDescription(const std::string & prefix, const InterfaceInfo & told) : prefix_name(prefix), info(told) {}
  std::string prefix_name;
  InterfaceInfo info;
};

class StateInterface
{
public:
  using SharedPtr = std::shared_ptr<StateInterface>;
  using ConstSharedPtr = std::shared_ptr<const StateInterface>;
  explicit StateInterface(const InterfaceDescription & told)
  : name_(told.prefix_name + "/" + told.info.name),
    value_(told.info.initial_value.empty() ? 0.0 : std::stod(told.info.initial_value))
  {
  }
  std::string get_name() const { return name_; }
  template <typename T = double>
  [[nodiscard]] std::optional<T> get_optional() const
  {
    return value_;
  }
  template <typename T>
  [[nodiscard]] bool set_value(const T & value)
  {
    value_ = value;
    return true;
  }

private:
  std::string name_;
  double value_;
};

class CommandInterface : public StateInterface
{
public:
  using SharedPtr = std::shared_ptr<CommandInterface>;
  using StateInterface::StateInterface;
};

class LoanedStateInterface
{
public:
  LoanedStateInterface(StateInterface::ConstSharedPtr lent, std::function<void()> &&) : lent_(std::move(lent)) {}
  template <typename T = double>
  [[nodiscard]] std::optional<T> get_optional(unsigned int = 10) const
  {
    return lent_->get_optional<T>();
  }

private:
  StateInterface::ConstSharedPtr lent_;
};

class LoanedCommandInterface
{
public:
  LoanedCommandInterface(CommandInterface::SharedPtr lent, std::function<void()> &&) : lent_(std::move(lent)) {}
  template <typename T>
  [[nodiscard]] bool set_value(const T & value, unsigned int = 10)
  {
    return lent_->set_value(value);
  }

private:
  CommandInterface::SharedPtr lent_;
};
}  // namespace hardware_interface

#endif
