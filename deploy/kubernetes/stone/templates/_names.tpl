{{/* The name of a role's objects: <release>-<role>. */}}
{{- define "stone.name" -}}
{{ printf "%s-%s" .root.Release.Name .role | trunc 52 | trimSuffix "-" }}
{{- end }}

{{/* The labels of selectors. */}}
{{- define "stone.selector" -}}
app.kubernetes.io/name: {{ .root.Chart.Name }}
app.kubernetes.io/instance: {{ .root.Release.Name }}
app.kubernetes.io/component: {{ .role }}
{{- end }}

{{- define "stone.labels" -}}
{{ include "stone.selector" . }}
app.kubernetes.io/version: {{ .root.Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .root.Release.Service }}
helm.sh/chart: {{ printf "%s-%s" .root.Chart.Name .root.Chart.Version }}
{{- end }}

{{/* The image of a role: three services have their own image, all other roles use the API's. */}}
{{- define "stone.image" -}}
{{- $service := ternary .role "api" (has .role (list "ingest" "labeler" "eval")) -}}
{{ printf "%s-%s:%s" .root.Values.image.repository $service (.root.Values.image.tag | default .root.Chart.AppVersion) }}
{{- end }}

{{/* Replicas of a role; none while the platform is stopped. */}}
{{- define "stone.replicas" -}}
{{ ternary 0 (int .replicas) .root.Values.stopped }}
{{- end }}
