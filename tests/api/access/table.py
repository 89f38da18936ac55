"""What every caller is answered on every route: the one table of expectations.

**Conventions.** A row is an operation of the document and a status for each of `CALLERS`, in their order; each caller
asks for the owner's things, with a body that is valid. A route without a row, and a row without a route, fail.

    anon   nobody                       part    a participant          owner   a curator, whose everything is
    other  another curator              admin   an administrator       mod     the administrator's token without `admin`
    narr   the owner's token without the scope that is asked for       exp     the owner's token, expired
    inact  a curator who was shut out   web     the owner's browser    forg    the owner's browser without X-CSRF-Token
"""

from collections.abc import Mapping

from tests.api.access.cast import CALLERS

Operation = tuple[str, str]
"""Method and path template."""

TABLE = """
                                                             anon part owner other admin mod narr exp inact web forg
GET    /healthz                                               200  200  200   200   200  200 200  200  200  200 200
GET    /readyz                                                503  503  503   503   503  503 503  503  503  503 503
GET    /metrics                                               401  403  403   403   200  403 403  401  401  403 403
GET    /api/v1/docs                                           200  200  200   200   200  200 200  200  200  200 200
GET    /api/v1/problems                                       200  200  200   200   200  200 200  200  200  200 200
GET    /api/v1/problems/{code}                                200  200  200   200   200  200 200  200  200  200 200
GET    /api/v1/client                                         200  200  200   200   200  200 200  200  200  200 200
POST   /api/v1/sessions                                       401  201  201   201   201  201 201  201  401  201 201
GET    /api/v1/sessions                                       401  200  200   200   200  200 403  401  401  200 200
DELETE /api/v1/sessions/others                                401  204  204   204   204  204 403  401  401  204 403
DELETE /api/v1/sessions/current                               401  409  409   409   409  409 409  401  401  204 403
GET    /api/v1/me                                             401  200  200   200   200  200 403  401  401  200 200
PUT    /api/v1/me/password                                    401  204  204   204   204  204 403  401  401  204 403
GET    /api/v1/sign-in                                        200  200  200   200   200  200 200  200  200  200 200
GET    /api/v1/sign-in/oidc                                   404  404  404   404   404  404 404  404  404  404 404
GET    /api/v1/sign-in/oidc/callback                          404  404  404   404   404  404 404  404  404  404 404
POST   /api/v1/device-grants                                  201  201  201   201   201  201 201  201  201  201 201
POST   /api/v1/device-grants/decision                         401  403  403   403   403  403 403  401  401  404 403
POST   /api/v1/device-grants/token                            400  400  400   400   400  400 400  400  400  400 400
POST   /api/v1/tokens                                         401  403  201   201   201  201 403  401  401  201 403
GET    /api/v1/tokens                                         401  200  200   200   200  200 403  401  401  200 200
DELETE /api/v1/tokens/current                                 401  204  204   204   204  204 204  401  401  409 403
DELETE /api/v1/tokens/{token_id}                              401  404  204   404   404  404 403  401  401  204 403
POST   /api/v1/admin/users                                    401  403  403   403   201  403 403  401  401  403 403
GET    /api/v1/admin/users                                    401  403  403   403   200  403 403  401  401  403 403
PATCH  /api/v1/admin/users/{user_id}                          401  403  403   403   200  403 403  401  401  403 403
GET    /api/v1/admin/users/{user_id}/tokens                   401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/admin/users/{user_id}/tokens/{token_id}/revoke 401  403  403   403   204  403 403  401  401  403 403
POST   /api/v1/admin/users/{user_id}/credentials/revoke       401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/admin/users/{user_id}/erase                    401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/teams                                          401  201  201   201   201  201 403  401  401  201 403
GET    /api/v1/teams                                          401  200  200   200   200  200 403  401  401  200 200
POST   /api/v1/teams/memberships                              401  404  404   404   404  404 403  401  401  404 403
GET    /api/v1/teams/{team_id}                                401  404  200   404   200  404 403  401  401  200 200
POST   /api/v1/teams/{team_id}/invitations                    401  404  201   404   403  404 403  401  401  201 403
GET    /api/v1/teams/{team_id}/invitations                    401  404  200   404   200  404 403  401  401  200 200
DELETE /api/v1/teams/{team_id}/invitations/{invitation_id}    401  404  204   404   403  404 403  401  401  204 403
DELETE /api/v1/teams/{team_id}/members/{member}               401  404  204   404   422  404 403  401  401  204 403
PUT    /api/v1/teams/{team_id}/captain                        401  404  200   404   200  404 403  401  401  200 403
GET    /api/v1/notifications                                  401  200  200   200   200  200 403  401  401  200 200
PUT    /api/v1/notifications/choices                          401  200  200   200   200  200 403  401  401  200 403
PUT    /api/v1/notifications/email                            401  409  409   409   409  409 403  401  401  409 403
POST   /api/v1/notifications/email/verification               401  409  409   409   409  409 403  401  401  409 403
DELETE /api/v1/notifications/email                            401  204  204   204   204  204 403  401  401  204 403
PUT    /api/v1/notifications/webhook                          401  200  200   200   200  200 403  401  401  200 403
POST   /api/v1/notifications/webhook/secret                   401  404  404   404   404  404 403  401  401  404 403
DELETE /api/v1/notifications/webhook                          401  204  204   204   204  204 403  401  401  204 403
GET    /api/v1/notifications/deliveries                       401  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/admin/audit-log                                401  403  403   403   200  403 403  401  401  403 403
GET    /api/v1/admin/audit-log/verification                   401  403  403   403   200  403 403  401  401  403 403
OPTIONS /api/v1/uploads                                       204  204  204   204   204  204 204  204  204  204 204
POST   /api/v1/uploads                                        401  403  201   201   201  201 403  401  401  201 403
GET    /api/v1/uploads                                        401  200  200   200   200  200 403  401  401  200 200
POST   /api/v1/uploads/form                                   401  403  201   201   201  201 403  401  401  201 403
HEAD   /api/v1/uploads/{upload_id}                            401  404  200   404   404  404 403  401  401  200 200
PATCH  /api/v1/uploads/{upload_id}                            401  404  204   404   404  404 403  401  401  204 403
DELETE /api/v1/uploads/{upload_id}                            401  404  204   404   404  404 403  401  401  204 403
POST   /api/v1/uploads/{upload_id}                            401  404  204   404   404  404 403  401  401  204 403
GET    /api/v1/uploads/{upload_id}                            401  404  200   404   404  404 403  401  401  200 200
POST   /api/v1/sequences                                      401  403  201   201   201  201 403  401  401  201 403
GET    /api/v1/sequences                                      200  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/sequences/{sequence_id}                        401  404  200   404   200  404 403  401  401  200 200
PATCH  /api/v1/sequences/{sequence_id}                        401  403  200   404   200  404 403  401  401  200 403
DELETE /api/v1/sequences/{sequence_id}                        401  403  204   404   204  404 403  401  401  204 403
PUT    /api/v1/sequences/{sequence_id}/calibration            401  403  200   404   200  404 403  401  401  200 403
POST   /api/v1/calibrations                                   401  403  201   201   201  201 403  401  401  201 403
GET    /api/v1/calibrations                                   401  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/calibrations/{calibration_id}                  401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/calibrations/{calibration_id}/file             401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/calibrations/{calibration_id}/diff             401  404  200   404   200  404 403  401  401  200 200
POST   /api/v1/sequences/{sequence_id}/recordings             401  403  202   404   404  404 403  401  401  202 403
GET    /api/v1/sequences/{sequence_id}/recordings             401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/sequences/{sequence_id}/recordings/{recording_id}     401 404 200 404 200 404 403 401 401 200 200
DELETE /api/v1/sequences/{sequence_id}/recordings/{recording_id}     401 403 204 404 204 404 403 401 401 204 403
GET /api/v1/sequences/{sequence_id}/recordings/{recording_id}/previews/{name} 401 404 200 404 200 404 403 401 401 200 200
GET    /api/v1/sequences/{sequence_id}/recordings/{recording_id}/roles 401 404 200 404 200 404 403 401 401 200 200
GET    /api/v1/recording-roots                                401  403  200   200   200  200 403  401  401  200 200
POST   /api/v1/dataset-imports                                401  403  202   404   404  404 403  401  401  202 403
GET    /api/v1/dataset-imports                                401  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/dataset-imports/{import_id}                    401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/dataset-imports/{import_id}/files/{path}       401  404  200   404   200  404 403  401  401  200 200
HEAD   /api/v1/dataset-imports/{import_id}/files/{path}       401  404  200   404   200  404 403  401  401  200 200
DELETE /api/v1/dataset-imports/{import_id}                    401  403  204   404   204  404 403  401  401  204 403
GET    /api/v1/profiles                                       401  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/profiles/{platform_name}                       401  404  200   404   404  404 403  401  401  200 200
PUT    /api/v1/profiles/{platform_name}                       401  403  200   201   201  201 403  401  401  200 403
POST   /api/v1/sequences/{sequence_id}/process                401  403  202   404   202  404 403  401  401  202 403
GET    /api/v1/sequences/{sequence_id}/frames                 401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/sequences/{sequence_id}/report                 401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/sequences/{sequence_id}/frames.parquet         401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/sequences/{sequence_id}/grid.json              401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/sequences/{sequence_id}/mesh                   401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/sequences/{sequence_id}/previews/{name}        401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/sequences/{sequence_id}/events                 401  404  200   404   200  404 403  401  401  200 200
POST   /api/v1/sequences/{sequence_id}/exports                401  403  202   404   202  404 403  401  401  202 403
GET    /api/v1/sequences/{sequence_id}/exports                401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/sequences/{sequence_id}/exports/{export_id}    401  404  200   404   200  404 403  401  401  200 200
DELETE /api/v1/sequences/{sequence_id}/exports/{export_id}    401  403  204   404   204  404 403  401  401  204 403
GET    /api/v1/sequences/{sequence_id}/exports/{export_id}/files      401 404 200 404 200 404 403 401 401 200 200
GET    /api/v1/sequences/{sequence_id}/exports/{export_id}/files/{path} 401 404 200 404 200 404 403 401 401 200 200
HEAD   /api/v1/sequences/{sequence_id}/exports/{export_id}/files/{path} 401 404 200 404 200 404 403 401 401 200 200
GET    /api/v1/sequences/{sequence_id}/exports/{export_id}/archive    401 404 200 404 200 404 403 401 401 200 200
HEAD   /api/v1/sequences/{sequence_id}/exports/{export_id}/archive    401 404 200 404 200 404 403 401 401 200 200
GET    /api/v1/sequences/{sequence_id}/label-sets                     401 404 200 404 200 404 403 401 401 200 200
DELETE /api/v1/sequences/{sequence_id}/label-sets/{label_set_id}      401 403 204 404 204 404 403 401 401 204 403
POST   /api/v1/sequences/{sequence_id}/label-sets/{label_set_id}/activate 401 403 200 404 200 404 403 401 401 200 403
GET    /api/v1/sequences/{sequence_id}/label-sets/{label_set_id}/frames/{token}/voxels 401 404 200 404 200 404 403 401 401 200 200
POST   /api/v1/sequences/{sequence_id}/label-comparisons              401 403 202 404 202 404 403 401 401 202 403
GET    /api/v1/sequences/{sequence_id}/label-comparisons              401 404 200 404 200 404 403 401 401 200 200
GET    /api/v1/sequences/{sequence_id}/label-comparisons/{comparison_id} 401 404 200 404 200 404 403 401 401 200 200
GET    /api/v1/sequences/{sequence_id}/label-comparisons/{comparison_id}/frames/{token}.png 401 404 200 404 200 404 403 401 401 200 200
GET    /api/v1/sequences/{sequence_id}/label-comparisons/{comparison_id}/frames/{token}/voxels 401 404 200 404 200 404 403 401 401 200 200
GET    /api/v1/sequences/{sequence_id}/sequence.npz           401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/frames/{token}                                 401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/frames/{token}/labels.npz                      401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/frames/{token}/voxels                          401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/frames/{token}/bev.png                         401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/frames/{token}/camera/{channel}.jpg            401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/frames/{token}/cloud                           401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/frames/{token}/radar                           401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/sequences/{sequence_id}/scene                  401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/sequences/{sequence_id}/scene/cameras          401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/sequences/{sequence_id}/scene/tiles/{tile_name}  401 404 200 404 200 404 403 401 401 200 200
GET    /api/v1/sequences/{sequence_id}/scene/meshes/{tile_name} 401 404 200 404 200 404 403 401 401 200 200
GET    /api/v1/splits                                         401  200  200   200   200  200 403  401  401  200 200
PUT    /api/v1/splits                                         401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/splits/verdicts                                401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/splits/proposal                                401  403  403   403   200  403 403  401  401  403 403
GET    /api/v1/statistics                                     401  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/statistics/composition.png                     401  200  200   200   200  200 403  401  401  200 200
POST   /api/v1/datasets                                       401  403  403   403   201  403 403  401  401  403 403
GET    /api/v1/datasets                                       401  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/datasets/{dataset_name}                        401  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/datasets/{dataset_name}/manifest               401  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/datasets/{dataset_name}/archives/{part}        401  200  200   200   200  200 403  401  401  200 200
POST   /api/v1/admin/datasets/{dataset_name}/inputs           401  403  403   403   202  403 403  401  401  403 403
GET    /api/v1/datasets/{dataset_name}/inputs                 401  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/datasets/{dataset_name}/inputs/{sequence_name}.tar 401 200 200 200  200  200 403  401  401  200 200
HEAD   /api/v1/datasets/{dataset_name}/inputs/{sequence_name}.tar 401 200 200 200  200  200 403  401  401  200 200
POST   /api/v1/admin/phases/{phase_id}/inputs                 401  403  403   403   202  403 403  401  401  403 403
GET    /api/v1/phases/{phase_id}/inputs                       401  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/phases/{phase_id}/inputs/{sequence_name}.tar   401  200  200   200   200  200 403  401  401  200 200
HEAD   /api/v1/phases/{phase_id}/inputs/{sequence_name}.tar   401  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/benchmarks                                     200  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/benchmarks/{benchmark_name}                    401  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/benchmarks/{benchmark_name}/phases/{phase_name}           401 200 200 200 200 200 403 401 401 200 200
GET    /api/v1/benchmarks/{benchmark_name}/phases/{phase_name}/manifest  401 200 200 200 200 200 403 401 401 200 200
GET    /api/v1/benchmarks/{benchmark_name}/phases/{phase_name}/metrics/{metric} 401 200 200 200 200 200 403 401 401 200 200
GET    /api/v1/benchmarks/{benchmark_name}/phases/{phase_name}/metrics/{metric}/vectors 401 200 200 200 200 200 403 401 401 200 200
GET    /api/v1/benchmarks/{benchmark_name}/phases/{phase_name}/frames/{token}.png 401 404 404 404 404 404 403 401 401 404 404
GET    /api/v1/phases/{phase_id}                              401  200  200   200   200  200 403  401  401  200 200
POST   /api/v1/admin/benchmarks                               401  403  403   403   201  403 403  401  401  403 403
PATCH  /api/v1/admin/benchmarks/{benchmark_name}              401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/admin/benchmarks/{benchmark_name}/phases       401  403  403   403   201  403 403  401  401  403 403
GET    /api/v1/admin/phases/{phase_id}                        401  403  403   403   200  403 403  401  401  403 403
PATCH  /api/v1/admin/phases/{phase_id}                        401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/admin/phases/{phase_id}/ground-truths          401  403  403   403   202  403 403  401  401  403 403
GET    /api/v1/admin/phases/{phase_id}/ground-truths          401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/admin/phases/{phase_id}/rescores               401  403  403   403   202  403 403  401  401  403 403
GET    /api/v1/admin/phases/{phase_id}/rescores               401  403  403   403   200  403 403  401  401  403 403
GET    /api/v1/admin/phases/{phase_id}/rescores/{rescore_id}  401  403  403   403   200  403 403  401  401  403 403
GET    /api/v1/admin/phases/{phase_id}/rescores/{rescore_id}/diff 401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/admin/phases/{phase_id}/rescores/{rescore_id}/activate 401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/admin/phases/{phase_id}/rescores/{rescore_id}/abandon 401  403  403   403   200  403 403  401  401  403 403
GET    /api/v1/admin/phases/{phase_id}/alarms                 401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/admin/alarms/{alarm_id}/dismiss                401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/admin/teams/{team_id}/grants                   401  403  403   403   201  403 403  401  401  403 403
PUT    /api/v1/admin/phases/{phase_id}/reported               401  403  403   403   200  403 403  401  401  403 403
GET    /api/v1/admin/phases/{phase_id}/reported               401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/phases/{phase_id}/submissions                  401  404  201   404   404  404 403  401  401  201 403
POST   /api/v1/phases/{phase_id}/validations                  401  404  201   404   404  404 403  401  401  201 403
GET    /api/v1/phases/{phase_id}/teams/{team_id}/quota        401  404  200   404   200  404 403  401  401  200 200
POST   /api/v1/submissions/{submission_id}/finalize           401  404  202   404   202  404 403  401  401  202 403
GET    /api/v1/submissions                                    401  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/submissions/{submission_id}                    401  404  200   404   200  404 403  401  401  200 200
PATCH  /api/v1/submissions/{submission_id}                    401  404  200   404   200  404 403  401  401  200 403
GET    /api/v1/submissions/{submission_id}/validation-report  401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/submissions/{submission_id}/events             401  404  200   404   200  404 403  401  401  200 200
POST   /api/v1/submissions/{submission_id}/cancel             401  404  200   404   200  404 403  401  401  200 403
POST   /api/v1/submissions/{submission_id}/withdraw           401  404  200   404   200  404 403  401  401  200 403
PUT    /api/v1/admin/submissions/{submission_id}/visibility   401  403  403   403   200  403 403  401  401  403 403
GET    /api/v1/benchmarks/{benchmark_name}/phases/{phase_name}/leaderboard 401 200 200 200 200 200 403 401 401 200 200
GET    /api/v1/benchmarks/{benchmark_name}/phases/{phase_name}/leaderboard/history 401 200 200 200 200 200 403 401 401 200 200
GET    /api/v1/benchmarks/{benchmark_name}/phases/{phase_name}/compare 401 404 200 404 200 404 403 401 401 200 200
GET    /api/v1/submissions/{submission_id}/results            401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/submissions/{submission_id}/results/breakdowns 401  404  403   404   200  404 403  401  401  403 403
GET    /api/v1/submissions/{submission_id}/provenance         401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/submissions/{submission_id}/confusions         401  404  403   404   200  404 403  401  401  403 403
GET    /api/v1/submissions/{submission_id}/frames/{token}.png     401  404  403   404   403  404 403  401  401  403 403
GET    /api/v1/submissions/{submission_id}/predictions.zip        401  404  200   404   200  404 403  401  401  200 200
HEAD   /api/v1/submissions/{submission_id}/predictions.zip        401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/jobs                                           401  200  200   200   200  200 403  401  401  200 200
GET    /api/v1/jobs/{job_id}                                  401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/jobs/{job_id}/logs                             401  404  200   404   200  404 403  401  401  200 200
GET    /api/v1/jobs/{job_id}/events                           401  404  200   404   200  404 403  401  401  200 200
POST   /api/v1/jobs/{job_id}/cancel                           401  403  202   404   202  404 403  401  401  202 403
GET    /api/v1/admin/jobs                                     401  403  403   403   200  403 403  401  401  403 403
GET    /api/v1/admin/jobs/counts                              401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/admin/jobs/acts                                401  403  403   403   200  403 403  401  401  403 403
GET    /api/v1/admin/jobs/{job_id}                            401  403  403   403   200  403 403  401  401  403 403
GET    /api/v1/admin/jobs/{job_id}/logs                       401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/admin/jobs/{job_id}/{act}                      401  403  403   403   202  403 403  401  401  403 403
GET    /api/v1/admin/queues                                   401  403  403   403   200  403 403  401  401  403 403
POST   /api/v1/admin/queues/{queue}/{act}                     401  403  403   403   200  403 403  401  401  403 403
GET    /api/v1/admin/workers                                  401  403  403   403   200  403 403  401  401  403 403
"""  # noqa: E501  (one row is a character too long)


def expectations(table: str = TABLE) -> dict[Operation, Mapping[str, int]]:
    """The table by operation and caller."""
    rows = [line.split() for line in table.splitlines() if "/" in line]
    parsed = {(method, path): dict(zip(CALLERS, map(int, statuses), strict=True)) for method, path, *statuses in rows}
    assert len(parsed) == len(rows), "a route stands twice in the table"
    return dict(parsed)
