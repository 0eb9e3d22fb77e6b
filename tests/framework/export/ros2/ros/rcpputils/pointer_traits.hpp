// A stand-in: what a pointer points to.
#include <memory>

namespace rcpputils
{
template <typename T>
struct remove_pointer : std::pointer_traits<T>
{
  using type = typename std::pointer_traits<T>::element_type;
};
template <typename T>
struct is_pointer : std::is_pointer<T>
{
};
}  // namespace rcpputils
