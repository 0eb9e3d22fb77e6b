// A stand-in: a loader makes the class by this function.
#define PLUGINLIB_EXPORT_CLASS(Class, Base) \
  std::shared_ptr<Base> created_controller() { return std::make_shared<Class>(); }
