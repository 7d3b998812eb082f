"""The ROS node and its worker process: they convert, call the core and publish; no mathematics.

The way of one window, down on the left and up on the right. `tasks` holds what is handed on, the
queue in front of the supervisor and the channel to the worker.

    event message                                                        twist
    event_source  finds the topic by topic_search, subscribes            twist_output
    event_feed    lets messages wait in a backlog, not for long
    event_input   decodes messages, cuts windows                         outputs
    pipeline      adds camera and settings; imu_source adds the gyro     answers
    supervisor    feeds the worker process, replaces it when it fails    supervisor
    worker        -------------- estimates in its own process ---------> worker

`executable` starts `estimator_node`, which makes all of these as its lifecycle demands.
"""
