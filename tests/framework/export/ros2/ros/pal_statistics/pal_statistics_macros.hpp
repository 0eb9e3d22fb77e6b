// A stand-in: nothing is registered.
#ifndef STAND_IN_PAL_STATISTICS
#define STAND_IN_PAL_STATISTICS

#include <functional>
#include <string>

namespace pal_statistics
{
using IdType = unsigned int;
class RegistrationsRAII
{
public:
  void enableAll() {}
  void disableAll() {}
};
class StatisticsRegistry
{
public:
  template <typename... T>
  IdType registerVariable(T &&...)
  {
    return 0;
  }
  template <typename... T>
  IdType registerFunction(T &&...)
  {
    return 0;
  }
};
template <typename T>
IdType customRegister(StatisticsRegistry &, const std::string &, const T *, RegistrationsRAII *, bool)
{
  return 0;
}
}  // namespace pal_statistics

#define REGISTER_ENTITY(...)
#define UNREGISTER_ENTITY(...)

#endif
